"""A tracked robot in a synthetic off-road world, recorded by its whole rig, with the exact ground truth."""
