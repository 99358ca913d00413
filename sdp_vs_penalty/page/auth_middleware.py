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
from starlette.responses import HTMLResponse, RedirectResponse, Response
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
#: What is shown without it.
_CLOSED = """<!doctype html><html lang="en"><meta charset="utf-8">
<meta name="viewport" content="width=device-width"><title>sdp-vs-penalty</title>
<body style="font: 1.05rem/1.6 system-ui, sans-serif; max-width: 40rem; margin: 3rem auto;
padding: 0 1rem"><h1 style="font-size: 1.4rem">This address lacks its key</h1>
<p>Only who knows the key may see your measurements. The whole address stands in the
terminal in which the program was started: &ldquo;The workbench is at
http://127.0.0.1&hellip;?key=&hellip;&rdquo;. Open that.</p>
<p>Without that terminal: start <code>sdp-vs-penalty page</code> again, which opens it by
itself. Your projects are on disk, and are listed there.</p></body></html>
"""


def guarded(app: App, port: int, key: str) -> App:
    """Wrap the app in the checks of who may use it.

    Starlette checks the Host header (against DNS rebinding); :class:`AuthMiddleware`
    checks the key and the origin.
    """
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
        """Prepare the allowed origins and the response headers for a server at this
        port.

        The cookie's name holds the port, because browsers share cookies among ports:
        two servers on one computer must not overwrite each other's.
        """
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
        """Answer a request, or refuse it.

        A request with the key in its address gets the cookie and is redirected; one
        with the cookie reaches the app; any other one is refused.
        """
        if scope["type"] not in ("http", "websocket"):
            await self.app(scope, receive, send)
            return
        connection = HTTPConnection(scope)
        has_cookie = self._same(connection.cookies.get(self.cookie, ""))
        if self._is_refused(connection, has_cookie):
            await _refusal(scope["type"])(scope, receive, send)
            return

        async def with_headers(message: MutableMapping[str, Any]) -> None:
            if message["type"] == "http.response.start":
                MutableHeaders(scope=message).update(self.headers)
            await send(message)

        app = self.app if has_cookie else self._welcome(connection)
        try:
            await app(scope, receive, with_headers)
        except Exception as error:
            # A tab that asks for what has ended, too; 500 is answered already.
            _report(error)

    def _is_refused(self, connection: HTTPConnection, has_cookie: bool) -> bool:
        """Whether a request has neither key nor cookie, or comes from another web
        site.
        """
        is_socket = connection.scope["type"] == "websocket"
        has_key = self._brings_the_key(connection)
        if not has_cookie and not has_key:
            return True
        origin = connection.headers.get("origin")
        is_foreign = origin not in self.origins if origin else is_socket
        return is_foreign or self._comes_from_another_site(connection, has_key)

    def _brings_the_key(self, connection: HTTPConnection) -> bool:
        """Whether this is a GET request of the printed address, which holds the key."""
        scope = connection.scope
        is_get = scope["type"] == "http" and scope["method"] == "GET"
        return is_get and self._same(connection.query_params.get(KEY, ""))

    def _comes_from_another_site(self, connection: HTTPConnection, key: bool) -> bool:
        """Whether the browser says that another web site caused this request.

        Not every such request has an Origin header, but browsers send Sec-Fetch-Site. A
        link on another site is refused too, unless it is the printed address itself
        (``key``).
        """
        site = connection.headers.get("sec-fetch-site")
        is_navigation = connection.headers.get("sec-fetch-mode") == "navigate"
        return site in ("cross-site", "same-site") and not (is_navigation and key)

    def _same(self, token: str) -> bool:
        """Whether a token equals the key, compared in constant time."""
        return hmac.compare_digest(token.encode(), self.key.encode())

    def _welcome(self, connection: HTTPConnection) -> Response:
        """Redirect to the same address without the key, and store the key in a cookie.

        The cookie is hidden from scripts and from other sites.
        """
        other_query = urlencode(
            [(k, v) for k, v in connection.query_params.multi_items() if k != KEY]
        )
        # Never //host: that would lead elsewhere.
        path = "/" + connection.scope["path"].lstrip("/")
        if other_query:
            path += f"?{other_query}"
        cookie = f"{self.cookie}={self.key}; Path=/; HttpOnly; SameSite=Strict"
        return RedirectResponse(
            path, 303, {"set-cookie": cookie, "cache-control": "no-store"}
        )


def _refusal(kind: str) -> Any:
    """Return the response that refuses an unauthorised request or web socket."""
    if kind == "websocket":
        return WebSocketClose(1008)
    return HTMLResponse(_CLOSED, 403, {"connection": "close"})


def _report(error: Exception) -> None:
    """Print an error on stderr in one line, unless it only says that a tab was
    closed.
    """
    what = (str(error).splitlines() or [""])[0][:200]
    if what != "No response returned.":
        kind = type(error).__name__
        print(f"sdp-vs-penalty: page: {kind}: {printable(what)}", file=sys.stderr)
