"""What the pages of a sequence show, worked out of what the platform keeps: pure functions, but for `frame_table`."""
