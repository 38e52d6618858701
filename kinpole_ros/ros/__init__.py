"""The live side: everything that needs rclpy."""
