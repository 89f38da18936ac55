"""The platform's file formats: outputs that are complete or absent, and archives whose bytes are known in advance."""
