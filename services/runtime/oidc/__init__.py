"""Sign-in by a provider of OpenID Connect: the authorization code flow with PKCE.

**Conventions.** `provider.py` is the page to read first. The issuer is the administrator's setting and nothing else;
what it says of itself is checked against that. Every answer is read within bounds of size and time, redirects are not
followed, and what is not as the standard says is refused by a code of its own.

Source: OpenID Connect Core 1.0, Discovery 1.0; RFC 6749, 7636 (PKCE), 7517 (JWKS), 8725 (JWT best practices),
9207 (`iss` in the answer), 9700 (OAuth security).
"""
