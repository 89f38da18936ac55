"""The platform's costs of recordings and submissions, for sizing machines."""
