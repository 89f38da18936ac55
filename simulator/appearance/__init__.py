"""How the world looks: what covers the ground, the materials' textures, the light, and pixels made of them."""
