"""The pages of the docs site that are made of the code, so that they cannot fall behind it: `make docs`."""
