"""A tracked robot's drive through a drawn off-road world, recorded by its whole rig, with the exact truth beside it."""
