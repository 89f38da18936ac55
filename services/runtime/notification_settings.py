"""The settings of notifications: a group of `Settings`."""

from dataclasses import dataclass, field
from typing import Annotated, Literal

from pydantic import Field, SecretStr


@dataclass(frozen=True)
class NotificationSettings:
    """How people who chose so are told of events. Without `smtp_host` there is no e-mail.

    `smtp_security` is `starttls` (587), `tls` from the first byte (465), or `none`, for a relay on this very machine.
    `sender` is the address that e-mail comes from.

    Webhooks go to https addresses of the public Internet. With `allows_http` plain http does too; `webhook_networks`
    are networks (CIDR, between blanks or commas) of private addresses that webhooks may reach nevertheless, as the one
    in which a lab's own chat server stands. Whoever has an account can have requests sent there.

    What was not taken is sent again after `retry_s`, then after growing pauses, for three days; then it is a dead
    letter. A webhook that took nothing for `webhook_failing_s` is switched off. What is `kept_s` old is forgotten.
    """

    smtp_host: str = ""
    smtp_port: Annotated[int, Field(ge=1, le=65535)] = 587
    smtp_security: Literal["starttls", "tls", "none"] = "starttls"
    smtp_user: str = ""
    smtp_password: SecretStr = field(default=SecretStr(""))
    sender: str = ""
    allows_http: bool = False
    webhook_networks: str = ""
    retry_s: Annotated[float, Field(gt=0)] = 5.0
    webhook_failing_s: Annotated[float, Field(gt=0)] = 3 * 86400.0
    kept_s: Annotated[float, Field(gt=0)] = 30 * 86400.0

    @property
    def networks(self) -> list[str]:
        """`webhook_networks` one by one."""
        return self.webhook_networks.replace(",", " ").split()
