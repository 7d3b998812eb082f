"""One file per message type: each defines TYPES (ROS names) and DECODER (its class)."""
