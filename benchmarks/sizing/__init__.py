"""What recordings and submissions cost a platform, so that a machine can be sized for more of them."""
