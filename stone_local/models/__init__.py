"""What the commands of models share."""
