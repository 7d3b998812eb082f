"""The rclpy node and its worker process: convert, call the core, publish; no mathematics."""
