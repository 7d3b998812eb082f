"""MVSEC's table: our rows beside those of others."""
