"""The simulated sensors: LiDAR, cameras, radars, GNSS/INS and IMU, and their mounts on the robot."""
