"""One file per encoding of event_camera_msgs/EventPacket."""
