"""Authentication and authorisation: users, roles and scopes, passwords, tokens, browser sessions.

**Conventions.** A secret is shown once and stored as a hash. Roles are ordered, administrator > curator > participant.
A role allows scopes, and a token has some of them; a request has the scopes that role and token allow at that time.
"""
