"""The live side: all that needs rclpy, and nothing that computes."""
