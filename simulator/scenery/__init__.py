"""The simulated world: its terrain, its objects, the walker, and the robot's path through it."""
