"""The animation on the README's first screen."""
