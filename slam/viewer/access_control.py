"""Who may look: decided from the head of a request, before anything is told."""

from __future__ import annotations

import hmac
import ipaddress
import re
from collections.abc import Sequence
from dataclasses import dataclass
from urllib.parse import parse_qs, urlsplit

_HOST = re.compile(r"(?:[A-Za-z0-9.-]+|\[[0-9A-Fa-f:.]+\])(?::\d{1,5})?")
_LOCAL_NAMES = ("localhost", "127.0.0.1", "[::1]")


@dataclass(frozen=True, slots=True)
class AccessControl:
    """Without a token only this machine is served, and only under its local names.

    A page of another site can make a browser ask us: its `Origin` gives it away.  It can also
    let its own name resolve to 127.0.0.1 (DNS rebinding): then `Host` does.
    """

    token: str = ""

    def refusal(
        self, target: str, hosts: Sequence[str], origins: Sequence[str], public: bool = False
    ) -> str:
        """Say why a request is refused; empty if it is not.

        Args:
            target: path and query.
            hosts: values of the header `Host`.
            origins: values of the header `Origin`; programs other than browsers send none.
            public: whether the target tells nothing of the run, so that no token is needed.
        """
        if len(hosts) != 1 or not _HOST.fullmatch(hosts[0]):
            return "the header Host is missing or malformed"
        if not self.token and _name(hosts[0]) not in _LOCAL_NAMES:
            return f"this page is not served under the name {_name(hosts[0])}"
        if any(origin != f"http://{hosts[0]}" for origin in origins):
            return "pages of other sites may not look in here"
        if self.token and not public:
            given = parse_qs(urlsplit(target).query).get("token", [""])
            if not hmac.compare_digest(given[0].encode(), self.token.encode()):
                return "the token is missing or wrong: use the whole address that slam has printed"
        return ""


def _name(host: str) -> str:
    return re.sub(r":\d+$", "", host).lower()


def is_local(address: str) -> bool:
    """Whether an address to listen on can be reached from this machine alone."""
    if address == "localhost":
        return True
    try:
        return ipaddress.ip_address(address).is_loopback
    except ValueError:
        return False
