"""Who may ask: this machine, by its own name, from the workbench's own page, with the token, and not too much at once."""

from __future__ import annotations

import asyncio
import hashlib
import hmac
import secrets
from collections.abc import Awaitable, Callable, Mapping, MutableMapping
from dataclasses import dataclass, field
from ipaddress import ip_address
from typing import Any

import h11
from uvicorn.protocols.http.h11_impl import H11Protocol

Scope = MutableMapping[str, Any]
Message = MutableMapping[str, Any]
Receive = Callable[[], Awaitable[Message]]
Send = Callable[[Message], Awaitable[None]]
App = Callable[[Scope, Receive, Send], Awaitable[None]]

#: Seconds for the headers of a request, and for the next part of its body.
HEADER_SECONDS, BODY_SECONDS = 10.0, 30.0
#: Of a request that is no upload, and of an upload, bytes.
MOST_REQUEST, MOST_UPLOAD = 2_000_000, 4_000_000_000
_METHODS = ("GET", "HEAD", "POST", "PUT")
_PAGE_POLICY = (
    "default-src 'none'; script-src 'self'; style-src 'self' 'unsafe-inline'; img-src 'self' data: blob:;"
    " connect-src 'self'; frame-src 'self'; form-action 'none'; base-uri 'none'; frame-ancestors 'none'"
)
#: Of pages of results, which hold their own script: they run apart from the workbench and fetch nothing.
_VIEW_POLICY = (
    "sandbox allow-scripts; default-src 'none'; script-src 'unsafe-inline'; style-src 'unsafe-inline';"
    " img-src data: blob:; form-action 'none'; base-uri 'none'; frame-ancestors 'self'"
)
_ALWAYS = {
    "x-content-type-options": "nosniff",
    "referrer-policy": "no-referrer",
    "cross-origin-resource-policy": "same-origin",
    "cross-origin-opener-policy": "same-origin",
    "x-dns-prefetch-control": "off",
}
_WITHOUT_TOKEN = "The address lacks the token: open the whole address that `structid app` printed in the terminal."


@dataclass(frozen=True)
class Access:
    """Port and token that requests to a folder must have.

    Attributes
    ----------
    port : int
        On which the workbench is served.
    token : str
        First part of every path, another one for every folder.
    """

    port: int
    token: str = field(default_factory=lambda: secrets.token_urlsafe(24))

    @property
    def address(self) -> str:
        """Address that the browser opens."""
        return f"http://127.0.0.1:{self.port}/{self.token}/"

    def view_key(self, path: str) -> str:
        """Key for the report at `path`, 40 hexadecimal digits derived from the token; it opens nothing else."""
        return hmac.new(self.token.encode(), path.encode(), hashlib.sha256).hexdigest()[:40]

    def is_token(self, token: str) -> bool:
        """True if `token` is the token of this access; compared in constant time."""
        return hmac.compare_digest(token.encode(), self.token.encode())

    def is_view_key(self, key: str, path: str) -> bool:
        """True if `key` is the key of the page of results at `path`."""
        return hmac.compare_digest(key.encode(), self.view_key(path).encode())


class Guard:
    """Lets requests through that an `Access` allows, takes its token off their path, and puts the policies on the answers.

    Parameters
    ----------
    app : ASGI application
        Finds in ``scope["opened"]`` what the token of the request stands for.
    port : int
    opened : mapping from Access
        What each token opens, and nothing else; it may grow.
    """

    def __init__(self, app: App, port: int, opened: Mapping[Access, object]) -> None:
        self.app, self.port, self.opened = app, port, opened

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Handle an ASGI request: refuse it with a message, or pass it on with the workbench of its token's folder.

        The workbench is under ``opened`` of the scope. Bodies may have 2 MB, uploads (PUT) 4 GB. A request without a
        valid token is refused by 403, a larger body by 413. Start and end of the server ("lifespan") are passed on;
        connections other than HTTP are dropped.
        """
        if scope["type"] == "lifespan":
            await self.app(scope, receive, send)
            return
        if scope["type"] != "http":
            return
        refusal = _refusal(scope, self.port)
        first, _, rest = scope["path"].lstrip("/").partition("/")
        is_view = first == "view"
        if is_view:
            first, _, rest = rest.partition("/")
        let_in = [
            what
            for access, what in list(self.opened.items())
            if (access.is_view_key(first, rest) if is_view else access.is_token(first))
        ]
        if not let_in:
            refusal = refusal or (403, _WITHOUT_TOKEN)
        if refusal is None:
            length = next((v for k, v in scope["headers"] if k == b"content-length"), b"0")
            most = MOST_UPLOAD if scope["method"] == "PUT" else MOST_REQUEST
            if not length.isdigit() or int(length) > most:
                refusal = 413, f"More than {most // 1_000_000} MB at once is refused."
        send_with_policy = _with_policy(send, _VIEW_POLICY if is_view else _PAGE_POLICY)
        if refusal is not None:
            await _answer(send_with_policy, *refusal)
            return
        inner = "/view/" + rest if is_view else "/" + rest
        inner_scope = {**scope, "path": inner, "raw_path": inner.encode(), "opened": let_in[0]}
        await self.app(inner_scope, _limit_body(receive, most), send_with_policy)


def _refusal(scope: Scope, port: int) -> tuple[int, str] | None:
    """HTTP status and message for a request that is refused; None if it is admitted.

    It must come from this machine, name it and `port` as the host, and not be sent by a page of another site (else
    403), and use a known method (else 405).
    """
    hosts = {f"{name}:{port}" for name in ("127.0.0.1", "localhost", "[::1]")}
    headers = {name.decode("latin-1").lower(): value.decode("latin-1") for name, value in scope["headers"]}
    if not _is_loopback(scope.get("client")):
        return 403, "The workbench is for this machine only."
    if headers.get("host") not in hosts:
        return 403, "This name is not the workbench's: open the address that `structid app` printed."
    origin = headers.get("origin")
    if origin is not None and origin not in {f"http://{host}" for host in hosts}:
        return 403, "Requests from other pages are refused."
    is_opened = (
        scope["method"] == "GET" and headers.get("sec-fetch-dest") == "document" and scope["path"].count("/") == 2
    )
    if headers.get("sec-fetch-site", "none") not in ("same-origin", "none") and not (
        is_opened and scope["path"].endswith("/")  # from the file by which `structid app` opens a browser
    ):
        return 403, "Requests from other pages are refused."
    if scope["method"] not in _METHODS:
        return 405, "This method is not used here."
    return None


def _is_loopback(client: tuple[str, int] | None) -> bool:
    """True if `client` (address, port) is on this machine; False if None."""
    if client is None:
        return False
    try:
        return ip_address(client[0]).is_loopback
    except ValueError:
        return False


def _limit_body(receive: Receive, most: int) -> Receive:
    """ASGI receive function that reports a disconnect after more than `most` bytes of body, or 30 s without a part of it."""
    taken, is_whole = 0, False

    async def counted() -> Message:
        """Next ASGI message of the request, or a disconnect after too many bytes or too long a wait.

        That is after more than `most` bytes of body, or 30 s without a part of it; behind the body the wait is not
        limited.
        """
        nonlocal taken, is_whole
        try:
            async with asyncio.timeout(
                None if is_whole else BODY_SECONDS
            ):  # behind the body comes the end of the connection
                message = await receive()
        except TimeoutError:
            return {"type": "http.disconnect"}
        taken += len(message.get("body", b""))
        is_whole = is_whole or not message.get("more_body", False)
        return {"type": "http.disconnect"} if taken > most else message

    return counted


def _with_policy(send: Send, policy: str) -> Send:
    """ASGI send function that adds the content security policy `policy` and other security headers to each response.

    Responses that say nothing of caching are marked not to be stored. `send` is the function that ASGI gives.
    """

    async def sent(message: Message) -> None:
        """Send an ASGI message; the first message of a response gets `policy` and further security headers."""
        if message["type"] == "http.response.start":
            headers = {"content-security-policy": policy, **_ALWAYS}
            present = {name.lower() for name, _ in message.get("headers", [])}
            headers |= {} if b"cache-control" in present else {"cache-control": "no-store"}
            message = {
                **message,
                "headers": [*message.get("headers", []), *((k.encode(), v.encode()) for k, v in headers.items())],
            }
        await send(message)

    return sent


async def _answer(send: Send, status: int, text: str) -> None:
    """Send a complete response with the HTTP status `status` and the plain text `text`.

    `send` is the function that ASGI gives.
    """
    body = text.encode()
    headers = [(b"content-type", b"text/plain; charset=utf-8"), (b"content-length", str(len(body)).encode())]
    await send({"type": "http.response.start", "status": status, "headers": headers})
    await send({"type": "http.response.body", "body": body})


class DeadlineProtocol(H11Protocol):
    """HTTP/1.1 as uvicorn speaks it, which waits only so long for the rest of a request's headers."""

    _waiting: asyncio.TimerHandle | None = None

    def connection_made(self, transport: Any) -> None:
        """Take a new connection over `transport` and start the time within which its first request has to arrive."""
        super().connection_made(transport)
        self._await_headers()

    def data_received(self, data: bytes) -> None:
        """Handle the bytes `data` of a connection.

        The time limit for headers (10 s) starts with each request, and is not extended by further bytes.
        """
        super().data_received(data)
        if self.conn.their_state is not h11.IDLE:
            self._stop_waiting()
        elif self._waiting is None:
            self._await_headers()

    def connection_lost(self, exc: Exception | None) -> None:
        """Stop the time limit at the end of a connection; `exc` is the error that ended it, None for a regular end."""
        self._stop_waiting()
        super().connection_lost(exc)

    def _await_headers(self) -> None:
        self._stop_waiting()
        self._waiting = self.loop.call_later(HEADER_SECONDS, self._close_where_waiting)

    def _stop_waiting(self) -> None:
        if self._waiting is not None:
            self._waiting.cancel()
            self._waiting = None

    def _close_where_waiting(self) -> None:
        """Close the connection when the time limit for headers has passed, unless a response is still being sent."""
        self._waiting = None
        is_answering = self.cycle is not None and not self.cycle.response_complete
        if not (is_answering or self.transport.is_closing()):
            self.transport.close()
