"""Who may talk to the page: whoever has the printed address, from the page itself, and nobody else."""

from __future__ import annotations

import hmac
from collections.abc import Awaitable, Callable, MutableMapping
from http.cookies import CookieError, SimpleCookie
from typing import Any
from urllib.parse import parse_qsl, urlencode

Scope = MutableMapping[str, Any]
App = Callable[[Scope, Any, Any], Awaitable[None]]

_HEADERS = [
    (b"x-content-type-options", b"nosniff"),
    (b"x-frame-options", b"DENY"),
    (b"referrer-policy", b"no-referrer"),
    (b"cross-origin-opener-policy", b"same-origin"),
    # Nothing is asked of anybody else, whatever the data say.
    (
        b"content-security-policy",
        b"default-src 'self'; script-src 'self' 'unsafe-inline' 'unsafe-eval'; "
        b"style-src 'self' 'unsafe-inline'; img-src 'self' data: blob:; font-src 'self' data:; "
        b"connect-src 'self' SOCKETS; worker-src 'self' blob:; "
        b"object-src 'none'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'",
    ),
]


#: Where only this computer's own programs can ask.
LOOPBACK = ("127.0.0.1", "::1", "localhost")
#: Name of the key in the printed address.
KEY = "key"


class Gate:
    """ASGI middleware: refuses foreign Host headers (DNS rebinding), foreign origins and strangers.

    A page of another site can make a browser send requests to 127.0.0.1, under that site's name as
    Host, or with that site as Origin; neither is ours. Another account of this computer can ask as it
    likes: it does not know the ``key`` that is in the printed address, once, and in a cookie thereafter.
    """

    def __init__(
        self, app: App, port: int, key: str, host: str = "127.0.0.1", tls: bool = False
    ) -> None:
        self.app, self.key, self.tls = app, key, tls
        # Cookies know no ports: two servers on one computer must not take each other's away.
        self.cookie = f"sdp-vs-penalty-key-{port}"
        names = {host, "127.0.0.1", "localhost"} if host in LOOPBACK else {host}
        self.hosts = {f"{f'[{name}]' if ':' in name else name}:{port}".encode() for name in names}
        self.origins = {(b"https://" if tls else b"http://") + host for host in self.hosts}
        sockets = b" ".join((b"wss://" if tls else b"ws://") + host for host in sorted(self.hosts))
        self.headers = [(name, value.replace(b"SOCKETS", sockets)) for name, value in _HEADERS]

    async def __call__(self, scope: Scope, receive: Any, send: Any) -> None:
        if scope["type"] not in ("http", "websocket"):
            await self.app(scope, receive, send)
            return
        headers = dict(scope["headers"])
        origin = headers.get(b"origin")
        # Not every request of another site names its origin; browsers say where it comes from.
        elsewhere = headers.get(b"sec-fetch-site") in (b"cross-site", b"same-site")
        # A link from there opens nothing, unless it is the printed address itself.
        linked = headers.get(b"sec-fetch-mode") == b"navigate" and self._has_key(scope)
        elsewhere = elsewhere and not linked
        foreign = bool(origin) and origin not in self.origins
        nameless = scope["type"] == "websocket" and not origin
        if headers.get(b"host") not in self.hosts or foreign or elsewhere or nameless:
            await _refuse(scope, send)
            return
        if not self._has_cookie(headers):
            if scope["type"] == "http" and scope.get("method") == "GET" and self._has_key(scope):
                await self._welcome(scope, send)
            else:
                await _refuse(scope, send)
            return

        async def with_headers(message: MutableMapping[str, Any]) -> None:
            if message["type"] == "http.response.start":
                message["headers"] = [*message.get("headers", ()), *self.headers]
            await send(message)

        await self.app(scope, receive, with_headers)

    def _same(self, given: str) -> bool:
        return hmac.compare_digest(given.encode(), self.key.encode())

    def _has_cookie(self, headers: dict[bytes, bytes]) -> bool:
        try:
            found = SimpleCookie(headers.get(b"cookie", b"").decode("latin-1")).get(self.cookie)
        except CookieError:
            return False
        return found is not None and self._same(found.value)

    def _has_key(self, scope: Scope) -> bool:
        query = dict(parse_qsl(scope.get("query_string", b"").decode("latin-1")))
        return self._same(query.get(KEY, ""))

    async def _welcome(self, scope: Scope, send: Any) -> None:
        """The same address without the key, which stays in a cookie that no script and no site sees."""
        query = parse_qsl(scope.get("query_string", b"").decode("latin-1"))
        rest = urlencode([(name, value) for name, value in query if name != KEY])
        # Never //host: that would lead elsewhere.
        path = "/" + scope["path"].lstrip("/") + (f"?{rest}" if rest else "")
        cookie = f"{self.cookie}={self.key}; Path=/; HttpOnly; SameSite=Strict" + "; Secure" * self.tls
        headers = [
            (b"location", path.encode("latin-1", "replace")),
            (b"set-cookie", cookie.encode()),
            (b"cache-control", b"no-store"),
            *self.headers,
        ]
        await send({"type": "http.response.start", "status": 303, "headers": headers})
        await send({"type": "http.response.body", "body": b""})


async def _refuse(scope: Scope, send: Any) -> None:
    if scope["type"] == "websocket":
        await send({"type": "websocket.close", "code": 1008})
        return
    text = b"Only the page itself may ask here: open the address that was printed, key included.\n"
    headers = [(b"content-type", b"text/plain; charset=utf-8"), (b"connection", b"close")]
    await send({"type": "http.response.start", "status": 403, "headers": headers})
    await send({"type": "http.response.body", "body": text})
