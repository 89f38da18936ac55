"""What any process of the platform needs: outputs that are whole or absent."""
