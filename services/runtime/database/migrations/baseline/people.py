"""Users, their credentials and sign-ins, teams."""

from sqlalchemy import JSON, BigInteger, Boolean, ForeignKey, Integer, String

from services.runtime.database.migrations.baseline.tables import ID, indexes, key, optional, part_of, required, table

table(
    "users",
    key("id", ID),
    required("name", String(64), unique=True),
    required("role", String(16)),
    required("password_hash", String(256)),
    required("is_active", Boolean),
    required("created_ns", BigInteger),
)

table(
    "tokens",
    key("id", ID),
    required("user_id", ID, part_of("users.id")),
    required("name", String(64)),
    required("secret_hash", String(64), unique=True),
    required("scopes", JSON),
    required("created_ns", BigInteger),
    required("expires_ns", BigInteger),
    optional("used_ns", BigInteger),
    optional("parent_id", ID, part_of("tokens.id")),
    *indexes("user_id", "parent_id", "expires_ns"),
)

table(
    "web_sessions",
    key("id", ID),
    required("user_id", ID, part_of("users.id")),
    required("secret_hash", String(64), unique=True),
    required("csrf_token", String(64)),
    required("created_ns", BigInteger),
    required("expires_ns", BigInteger),
    required("used_ns", BigInteger),
    *indexes("user_id", "expires_ns", "used_ns"),
)

table(
    "sign_in_guesses",
    key("key", String(64)),
    required("failures", Integer),
    required("failed_ns", BigInteger),
    required("blocked_until_ns", BigInteger),
    *indexes("failed_ns"),
)

table(
    "sign_in_addresses",
    key("key", String(64)),
    required("user_id", ID, part_of("users.id")),
    required("used_ns", BigInteger),
    *indexes("user_id", "used_ns"),
)

table(
    "teams",
    key("id", ID),
    required("name", String(64), unique=True),
    required("created_ns", BigInteger),
)

table(
    "team_members",
    key("team_id", ID, part_of("teams.id")),
    key("user_id", ID, part_of("users.id")),
    required("is_owner", Boolean),
)

table(
    "team_invitations",
    key("id", ID),
    required("team_id", ID, part_of("teams.id")),
    required("secret_hash", String(64), unique=True),
    required("created_by", ID, ForeignKey("users.id")),
    required("created_ns", BigInteger),
    required("expires_ns", BigInteger),
    optional("used_by", ID, ForeignKey("users.id")),
    optional("used_ns", BigInteger),
    *indexes("team_id", "expires_ns"),
)

table(
    "external_identities",
    key("key", String(64)),
    required("issuer", String(500)),
    required("subject", String(255)),
    required("user_id", ID, part_of("users.id")),
    required("created_ns", BigInteger),
    required("used_ns", BigInteger),
    *indexes("user_id"),
)

table(
    "device_grants",
    key("id", ID),
    required("device_hash", String(64), unique=True),
    required("user_hash", String(64), unique=True),
    required("name", String(64)),
    required("address", String(64)),
    required("scopes", JSON),
    required("created_ns", BigInteger),
    required("expires_ns", BigInteger),
    required("polled_ns", BigInteger),
    required("is_denied", Boolean),
    optional("user_id", ID, part_of("users.id")),
    *indexes("expires_ns", "user_id"),
)
