"""Who may see the page: nobody but this computer, or whoever has the token; and no other site on their behalf."""

from __future__ import annotations

import hmac
import ipaddress
import secrets
import socket
from collections.abc import Mapping
from dataclasses import dataclass
from urllib.parse import urlsplit

from leadline.errors import InputError

DEFAULT_HOST, DEFAULT_PORT = "127.0.0.1", 8377
LEAST_TOKEN = 12  # characters


@dataclass(frozen=True, slots=True)
class Place:
    """Where the page is served; port 0: any that is free."""

    host: str = DEFAULT_HOST
    port: int = DEFAULT_PORT

    @property
    def loopback(self) -> bool:
        return self.host == "localhost" or ipaddress.ip_address(self.host).is_loopback

    @classmethod
    def parse(cls, text: str) -> Place:
        """``ADDRESS:PORT``, ``[IPv6]:PORT`` or ``:PORT`` (loopback). InputError where it is none of them."""
        host, colon, port = text.rpartition(":")
        host = host.removeprefix("[").removesuffix("]") or DEFAULT_HOST
        fix = "give ADDRESS:PORT, as 127.0.0.1:8377 (this computer) or 0.0.0.0:8377 (its network)"
        if not colon or not port.isascii() or not port.isdigit() or int(port) > 65535:
            raise InputError("is not an address with a port", f"--view-at {text}", fix)
        if host != "localhost":
            try:
                ipaddress.ip_address(host)
            except ValueError:
                raise InputError(f"'{host}' is not an IP address", f"--view-at {text}", fix) from None
        return cls(host, int(port))


def choose_token(place: Place, given: str | None) -> str | None:
    """The given one; beyond this computer a new one; else none. InputError where the given one is easily guessed."""
    if given:
        if (
            len(given) < LEAST_TOKEN
            or not (given.isascii() and given.isprintable())
            or any(c in given for c in ' ;,"\\')
        ):
            fix = f"take {LEAST_TOKEN} or more ASCII characters without spaces, quotes, commas and semicolons"
            raise InputError("is no good token", "LEADLINE_TOKEN", fix)
        return given
    return None if place.loopback else secrets.token_urlsafe(18)


@dataclass(frozen=True, slots=True)
class Access:
    """token: None where none is needed."""

    token: str | None

    def refusal(self, headers: Mapping[str, str], offered: str, *, acts: bool) -> tuple[int, str] | None:
        """HTTP status and words for whoever may not; None for who may. acts: a websocket, which takes commands.

        A name that is not this computer's is how a web site reaches into the network of its visitor (DNS rebinding);
        an origin that is not the page itself is another site's script.
        """
        host = headers.get("host", "")
        if not _own_name(host):
            return 421, "This computer does not go by that name. Use its IP address."
        origin = headers.get("origin")
        if acts and origin is not None and urlsplit(origin).netloc.lower() != host.lower():
            return 403, "Another site's page may not talk to this one."
        if self.token is not None and not hmac.compare_digest(self.token.encode(), offered.encode()):
            return 401, "This page needs its token: open the address that leadline printed."
        return None


def _own_name(host: str) -> bool:
    """A number cannot be rebound; of names, only our own."""
    try:
        name = urlsplit(f"//{host}").hostname or ""
    except ValueError:
        return False
    try:
        ipaddress.ip_address(name)
    except ValueError:
        own = socket.gethostname().lower()
        return bool(name) and name in ("localhost", own, f"{own.removesuffix('.local')}.local")
    return True
