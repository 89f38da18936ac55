"""Pages of the docs site that are generated from the code, so that they always match it: `make docs`."""
