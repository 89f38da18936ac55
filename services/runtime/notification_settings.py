"""The settings of notifications: a group of `Settings`."""

from dataclasses import dataclass, field
from typing import Annotated, Literal

from pydantic import Field, SecretStr


@dataclass(frozen=True)
class NotificationSettings:
    """Notifications of events to users who enabled them. Without `smtp_host` there is no e-mail.

    `smtp_security` is `starttls` (587), `tls` from the first byte (465), or `none`, for a relay on the same machine.
    `sender` is the sender address of e-mails.

    Webhooks go to https addresses on the public Internet. With `allows_http` plain http is allowed too.
    `webhook_networks` are networks (CIDR, separated by blanks or commas) of private addresses that webhooks may reach,
    such as the network of a lab's chat server. Any user can cause requests to these networks.

    A failed delivery is retried after `retry_s`, then after growing pauses, for three days; then it is a dead letter. A
    webhook without a successful delivery for `webhook_failing_s` is disabled. Deliveries older than `kept_s` are
    deleted.
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
        """The list of `webhook_networks`."""
        return self.webhook_networks.replace(",", " ").split()
