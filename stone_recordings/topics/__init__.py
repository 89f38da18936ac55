"""Topics and the sensor of the robot that each belongs to."""
