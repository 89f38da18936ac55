"""Short recordings as the drivers and packages of others write them, for tests of what people really bring."""
