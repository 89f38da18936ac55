"""What all of it says with the same words: errors, findings, names, the label grid. The standard library only."""
