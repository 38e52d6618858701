"""What people use: the command line, pictures, the mechanism's own analysis, the demo."""
