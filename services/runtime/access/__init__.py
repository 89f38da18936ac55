"""Authentication and authorisation: users, roles and scopes, passwords, tokens, browser sessions.

**Conventions.** A secret is shown once and kept as a hash. Roles are ordered, administrator > curator > participant; a
role allows scopes, a token holds some of them, and what counts is what both allow at the moment of the request.
"""
