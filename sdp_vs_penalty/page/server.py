"""The local server: addresses, who may ask, start and end."""

import asyncio
import contextlib
import errno
import gc
import json
import logging
import os
import secrets
import signal
import socket
import sys
import webbrowser
from pathlib import Path
from typing import Annotated

import uvicorn
from fastapi import Depends, FastAPI, HTTPException, Request, Response
from fastapi.responses import FileResponse, PlainTextResponse, RedirectResponse
from nicegui import app as nicegui_app
from nicegui import ui
from starlette.requests import ClientDisconnect

from sdp_vs_penalty import formatting
from sdp_vs_penalty.errors import InputError
from sdp_vs_penalty.page.auth_middleware import KEY, guarded
from sdp_vs_penalty.page.session import Session
from sdp_vs_penalty.page.sessions import SILENCE, Sessions, receive
from sdp_vs_penalty.page.spoken import name_beside, shown_name
from sdp_vs_penalty.page.stages import STAGES
from sdp_vs_penalty.page.view import Forms, View
from sdp_vs_penalty.page.workbench import Workbench
from sdp_vs_penalty.page.worker import WorkerPool, sentence
from sdp_vs_penalty.render.pieces import LOOK as PICTURES

_COOKIE = "sdp-vs-penalty-page"
#: Names the folder of the projects; if it is empty, nothing is kept.
PROJECTS_VARIABLE = "SDP_VS_PENALTY_PROJECTS"
_HERE = Path(__file__).parent
_SHOWN = ", ".join(f"[data-at={s.anchor}] [data-stage={s.anchor}]" for s in STAGES)
_STYLE = (
    f"{(_HERE / 'look.css').read_text('utf-8')}\n{PICTURES}\n:is({_SHOWN}) {{ display:"
    " block; }"
)
_LOOK = f"<style>{_STYLE}</style><script>{(_HERE / 'workbench.js').read_text('utf-8')}</script>"


def serve(
    folder: Path | None,
    project: Path | None,
    port: int | None,
    browser: bool,
    forms: Forms,
) -> None:
    """Serve the page on this computer until it is interrupted.

    Only who has the printed address, with its secret key, can open it.

    Parameters
    ----------
    folder : Path, optional
        Folder whose runs and URDF files the page offers.
    project : Path, optional
        Folder in which the work is kept, and from which it goes on; by default each
        page has one in the user's folder of projects.
    port : int, optional
        TCP port; by default any free one.
    browser : bool
        Whether to open the address in a browser.
    forms : mapping
        Options of the command line that the page shows as fields, by the step that
        offers them.

    Raises
    ------
    InputError
        For a folder that does not exist, or a port that is taken.
    """
    if folder is not None and not folder.is_dir():
        raise InputError(
            "not a folder", "name the folder with your runs, or leave it out", folder
        )
    sessions = Sessions(WorkerPool(), projects_folder())
    first = None if project is None else sessions.open_folder(project.absolute())
    # Listens already now, since the browser may connect before the server answers.
    listener = _listener(port)
    chosen = listener.getsockname()[1]
    os.environ["TMPDIR"] = str(sessions.root)  # for what workers keep while they work
    key = _kept_key(sessions.projects)
    path = "" if first is None else f"s/{first.token}"
    address = f"http://127.0.0.1:{chosen}/{path}?{KEY}={key}"
    print(f"The workbench is at {address} (Ctrl-C ends it)", flush=True)
    nicegui_app.on_startup(sessions.pool.prepare)
    # The server ends in order and then raises the signal again: leave by exit, so that
    # what Python itself keeps for processes is taken away too.
    signal.signal(signal.SIGTERM, lambda number, _: sys.exit(128 + number))
    if hasattr(signal, "SIGHUP"):  # the terminal is closed: end as if asked to
        signal.signal(signal.SIGHUP, lambda *_: os.kill(os.getpid(), signal.SIGTERM))
    if browser:
        nicegui_app.on_startup(lambda: asyncio.to_thread(webbrowser.open, address))
    # Otherwise it reports each tab that has lost its connection.
    logging.getLogger("engineio").setLevel(logging.CRITICAL)
    words = ["page", *([] if folder is None else [folder]), "--port", chosen]
    words += [] if project is None else ["--project", project]
    command = formatting.command(*words)
    config = uvicorn.Config(
        guarded(make_app(sessions, folder, forms, command), chosen, key),
        log_level="error",
        access_log=False,
        timeout_graceful_shutdown=1,
        server_header=False,
        lifespan="on",
    )
    gc.freeze()  # what is loaded stays; what tabs leave behind is looked for often
    gc.set_threshold(700, 10, 10)
    try:
        with contextlib.suppress(KeyboardInterrupt):
            uvicorn.Server(config).run(sockets=[listener])
    finally:
        sessions.close()
        gc.freeze()  # going through all objects once more takes Python a second


def projects_folder() -> Path | None:
    """Return the folder in which projects are kept: SDP_VS_PENALTY_PROJECTS, else one of
    the user's; None where the variable is empty: nothing is kept then."""
    named = os.environ.get(PROJECTS_VARIABLE)
    if named is not None:
        return Path(named).absolute() if named else None
    home = os.environ.get("XDG_DATA_HOME") or Path.home() / ".local" / "share"
    return Path(home) / "sdp-vs-penalty" / "projects"


def _kept_key(projects: Path | None) -> str:
    """Return the key of the printed address: the last server's, so that a tab that has
    lost its server finds the next one; a new one where projects are not kept.

    Its file can be read by its owner only.
    """
    key = secrets.token_urlsafe(24)
    if projects is None:
        return key
    file = projects / "key"
    with contextlib.suppress(OSError):
        projects.mkdir(mode=0o700, parents=True, exist_ok=True)
        with contextlib.suppress(FileExistsError):
            flags = os.O_WRONLY | os.O_CREAT | os.O_EXCL
            with open(os.open(file, flags, 0o600), "w", encoding="ascii") as made:
                made.write(key)
        kept = file.read_text("ascii").strip()
        is_private = not file.stat().st_mode & 0o077 or os.name == "nt"
        if is_private and len(kept) == len(key):
            return kept
    return key


def _listener(port: int | None) -> socket.socket:
    """Listen at a TCP port of this computer, None for any free one.

    Raises InputError if the port is taken.
    """
    try:
        return socket.create_server(("127.0.0.1", port or 0), backlog=128)
    except OSError as error:
        problem = f"fails ({error.strerror})"
        if error.errno == errno.EADDRINUSE:
            problem = "is taken"
        raise InputError(
            f"--port {port}: {problem}", "choose another, or leave it out"
        ) from error


def make_app(
    sessions: Sessions, folder: Path | None, forms: Forms, command: str = ""
) -> FastAPI:
    """Build the web application; ``command`` starts its server again.

    / continues the browser's last session or opens one, /new opens one, and /s/<token>
    shows the session of this secret token.
    """
    app = FastAPI(openapi_url=None, docs_url=None, redoc_url=None)

    def named(token: str) -> Session:
        if (session := sessions.get(token)) is None:
            raise HTTPException(404, "This page has ended: open a new one.")
        return session

    Named = Annotated[Session, Depends(named)]

    @app.get("/")
    @app.get("/new")
    async def _enter(request: Request) -> Response:
        closed = (
            sessions.unwatched(request.cookies.get(_COOKIE))
            if request.url.path == "/"
            else None
        )
        try:
            session = closed or sessions.new()
        except InputError as error:
            return PlainTextResponse(f"{error}\n", 503)
        response = RedirectResponse(f"/s/{session.token}", 303)
        response.set_cookie(_COOKIE, session.token, httponly=True, samesite="strict")
        return response

    @app.put("/s/{token}/files")
    async def _receive(session: Named, request: Request, name: str) -> Response:
        return Response(status_code=await keep(session, request, name))

    @app.post("/s/{token}/sent")
    async def _sent(session: Named) -> None:
        session.read_arrived()

    @app.get("/s/{token}/take/{name}")
    async def _take(session: Named, name: str) -> Response:
        if name not in os.listdir(session.folder):
            raise HTTPException(404, "There is no such file.")
        return FileResponse(
            session.folder / name, filename=name, headers={"cache-control": "no-store"}
        )

    @ui.page("/s/{token}", title="Robot dynamics from logs: sdp-vs-penalty")
    async def _show(token: str) -> Response | None:
        if (session := sessions.get(token)) is None:
            return RedirectResponse("/")
        client = ui.context.client
        ui.add_head_html(_LOOK)
        quoted = json.dumps(command).replace("<", "\\u003c")
        stages = json.dumps([stage.anchor for stage in STAGES])
        known = f"workbench.start = {quoted}; workbench.stages = {stages};"
        ui.add_head_html(f"<script>{known}</script>")
        projects = sessions.saved()
        view = View(session, folder, client, forms, projects, sessions.delete)
        bench = Workbench(view)
        client.on_delete(lambda: session.left(bench))
        client.on_exception(lambda error: session.say(sentence(error)))
        return None

    ui.run_with(
        app,
        title="sdp-vs-penalty",
        dark=None,
        tailwind=False,
        language="en-US",
        reconnect_timeout=SILENCE,
        show_welcome_message=False,
        gzip_middleware_factory=None,  # nothing travels: packing costs time alone
    )
    return app


async def keep(session: Session, request: Request, name_given: str) -> int:
    """Receive a dropped file, to be opened once all files have arrived; return the HTTP
    status."""
    name = shown_name(name_given)
    try:
        path = await receive(session.folder, name, request.stream())
    except ClientDisconnect:  # whoever sent it is gone, and what came of it too
        return 400
    except InputError as error:
        session.say(error.without_command)
        return 400
    except OSError as error:
        session.say(f"{name}: cannot be stored ({error.strerror}): free disk space.")
        return 507
    session.arrived[name_beside(name, session.arrived)] = path
    return 200
