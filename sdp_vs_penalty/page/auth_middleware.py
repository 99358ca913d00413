"""Who may talk to the page: whoever has the printed address, from the page itself, and
nobody else."""

import hmac
import sys
from collections.abc import Awaitable, Callable, MutableMapping
from typing import Any
from urllib.parse import urlencode

from starlette.datastructures import MutableHeaders
from starlette.middleware.trustedhost import TrustedHostMiddleware
from starlette.requests import HTTPConnection
from starlette.responses import PlainTextResponse, RedirectResponse, Response
from starlette.websockets import WebSocketClose

from sdp_vs_penalty.errors import printable

Scope = MutableMapping[str, Any]
App = Callable[[Scope, Any, Any], Awaitable[None]]

_HEADERS = {
    "x-content-type-options": "nosniff",
    "x-frame-options": "DENY",
    "referrer-policy": "no-referrer",
    "cross-origin-opener-policy": "same-origin",
    # Nothing is asked of anybody else, whatever the data say.
    "content-security-policy": (
        "default-src 'self'; script-src 'self' 'unsafe-inline' 'unsafe-eval'; style-src"
        " 'self' 'unsafe-inline'; img-src 'self' data: blob:; font-src 'self' data:;"
        " connect-src 'self' SOCKETS data:; worker-src 'self' blob:; object-src 'none';"
        " base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
    ),
}
#: The names of this computer that its own programs alone can ask.
_NAMES = ("127.0.0.1", "localhost")
#: Name of the key in the printed address.
KEY = "key"


def guarded(app: App, port: int, key: str) -> App:
    """The app behind Starlette's check of the Host header (DNS rebinding) and our own."""
    return TrustedHostMiddleware(
        AuthMiddleware(app, port, key), _NAMES, www_redirect=False
    )


class AuthMiddleware:
    """ASGI middleware: refuses foreign origins and strangers.

    A page of another site can make a browser send requests to 127.0.0.1, under that
    site's name as Host, or with that site as Origin; neither is ours. Another account
    of this computer can ask as it likes: it does not know the ``key`` that is in the
    printed address, once, and in a cookie thereafter.
    """

    def __init__(self, app: App, port: int, key: str) -> None:
        self.app = app
        self.key = key
        # Cookies know no ports: two servers on one computer must not take each other's
        # away.
        self.cookie = f"sdp-vs-penalty-key-{port}"
        self.origins = {f"http://{name}:{port}" for name in _NAMES}
        sockets = " ".join(f"ws://{name}:{port}" for name in _NAMES)
        self.headers = {
            name: value.replace("SOCKETS", sockets) for name, value in _HEADERS.items()
        }

    async def __call__(self, scope: Scope, receive: Any, send: Any) -> None:
        if scope["type"] not in ("http", "websocket"):
            await self.app(scope, receive, send)
            return
        connection = HTTPConnection(scope)
        socket = scope["type"] == "websocket"
        known = self._same(connection.cookies.get(self.cookie, ""))
        arrives = not socket and scope["method"] == "GET"
        arrives = arrives and self._same(connection.query_params.get(KEY, ""))
        origin = connection.headers.get("origin")
        mode = connection.headers.get("sec-fetch-mode")
        # Not every request of another site names its origin; browsers say where it
        # comes from.
        elsewhere = connection.headers.get("sec-fetch-site") in (
            "cross-site",
            "same-site",
        )
        # A link from there opens nothing, unless it is the printed address itself.
        elsewhere = elsewhere and not (mode == "navigate" and arrives)
        foreign = origin not in self.origins if origin else socket
        if foreign or elsewhere or not (known or arrives):
            text_shown = (
                "Only the page itself may ask: open the address that was printed, key"
                " included.\n"
            )
            refusal = PlainTextResponse(text_shown, 403, {"connection": "close"})
            await (WebSocketClose(1008) if socket else refusal)(scope, receive, send)
            return

        async def with_headers(message: MutableMapping[str, Any]) -> None:
            if message["type"] == "http.response.start":
                MutableHeaders(scope=message).update(self.headers)
            await send(message)

        try:
            await (self.app if known else self._welcome(connection))(
                scope, receive, with_headers
            )
        except (
            Exception
        ) as error:  # a tab that asks for what has ended, too; 500 is answered already
            what = (str(error).splitlines() or [""])[0][:200]
            if what != "No response returned.":  # the tab has gone
                kind = type(error).__name__
                print(
                    f"sdp-vs-penalty: page: {kind}: {printable(what)}", file=sys.stderr
                )

    def _same(self, token: str) -> bool:
        return hmac.compare_digest(token.encode(), self.key.encode())

    def _welcome(self, connection: HTTPConnection) -> Response:
        """The same address without the key, which stays in a cookie that no script and
        no site sees."""
        other_query = urlencode(
            [(k, v) for k, v in connection.query_params.multi_items() if k != KEY]
        )
        # Never //host: that would lead elsewhere.
        path = (
            "/"
            + connection.scope["path"].lstrip("/")
            + (f"?{other_query}" if other_query else "")
        )
        cookie = f"{self.cookie}={self.key}; Path=/; HttpOnly; SameSite=Strict"
        return RedirectResponse(
            path, 303, {"set-cookie": cookie, "cache-control": "no-store"}
        )
