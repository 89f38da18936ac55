"""Reports on a recording: its content, its quality and its faults."""
