"""The simulated sensors: LiDAR, cameras, radars, GNSS/INS and IMU, and where they sit on the robot."""
