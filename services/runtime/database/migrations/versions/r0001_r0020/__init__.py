"""From the first tables to counts that each process writes."""
