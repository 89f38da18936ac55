"""Topics: which of them is which sensor of the robot."""
