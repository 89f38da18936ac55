"""The appearance of the world: ground cover, material textures, light, and the rendered pixels."""
