"""Sign-in by a provider of OpenID Connect: the authorization code flow with PKCE.

**Conventions.** Read `provider.py` first. Only the administrator's setting defines the issuer; the provider's own
description is checked against it. Every answer is read within limits of size and time, redirects are not followed, and
each deviation from the standard is refused with a code of its own.

Source: OpenID Connect Core 1.0, Discovery 1.0; RFC 6749, 7636 (PKCE), 7517 (JWKS), 8725 (JWT best practices), 9207
(`iss` in the answer), 9700 (OAuth security).
"""
