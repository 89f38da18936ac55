"""Contents of a sequence's pages, computed from stored data: pure functions, but for `frame_table`."""
