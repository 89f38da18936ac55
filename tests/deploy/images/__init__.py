"""Tests of what the images are made of; that they run is shown by deploy/stand-in."""
