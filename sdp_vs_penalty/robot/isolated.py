"""Parsers of compiled code run in a process of their own: a broken file ends that
process, not this one.

The child is forked from this process while it has one thread, and otherwise from a
server, which is started with the first such file and ends with this process. The child
may take so much memory, CPU time and so many open files; it opens no socket and starts
no program (Linux). Its answers are arrays of floating-point numbers behind a JSON head,
through a pipe: nothing that it sends is executed.
"""

import ctypes
import gc
import importlib
import json
import os
import platform
import select
import signal
import struct
import subprocess
import sys
import time
import warnings
from collections.abc import Callable, Generator, Iterator, Mapping, Sequence
from contextlib import closing, suppress
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np

from sdp_vs_penalty.errors import InputError, Remark
from sdp_vs_penalty.files import memory_for
from sdp_vs_penalty.robot.arrays import Array, Arrays

#: What a child sends: heads, each with arrays. A head is empty where the parser has
#: yielded its arrays; else it says one thing: "remark" (a warning), "what" with "remedy",
#: "where" and "is_path" (an InputError), "not_installed" (an ImportError), "memory" (a
#: MemoryError), "failed" (why there is no answer), or "end" (a server is idle again).
_Messages = Generator[tuple[dict[str, Any], Arrays], None, None]


#: Longest silence of a parser [s].
_SILENCE = 20.0
#: CPU time of a file of no size [s], and more for a MiB of the file [s].
_CPU, _CPU_BY_MIB = 2.0, 2.0
#: Number of open files.
_OPEN_FILES = 64
#: Size of the head of one message, and of one array [bytes].
_HEAD, _ARRAY = 2**20, 2**34


@dataclass(frozen=True)
class _Request:
    """What a child is to parse, and its limits; plain JSON on the way to a server."""

    #: Module and name of the parser.
    parser: tuple[str, str]
    #: Arguments of the parser, first the path of the file.
    arguments: list[Any]
    #: Module that the parser needs; "" for none.
    library: str
    #: Memory that the child may add [bytes].
    room: int
    #: Longest silence [s].
    seconds: float
    #: CPU time [s].
    cpu: int
    #: Folder to work in; a server may have begun in another one.
    folder: str


class ParserEndedError(Exception):
    """The child has ended without an answer; the text says by what."""


def parse_isolated(
    parser: Callable[..., Iterator[Arrays]],
    path: str | Path,
    *arguments: Any,
    library: str = "",
    seconds: float = _SILENCE,
    n_bytes: int | None = None,
) -> Iterator[dict[str, Array]]:
    """Yield what ``parser(path, *arguments)`` yields, from a child process with limits.

    A broken or hostile file can then end the child only. An InputError of the parser is
    raised here.

    Parameters
    ----------
    parser : callable
        Function at the level of a module of this package.
    path : str or Path
        File, by whose size memory and time are limited.
    arguments
        Numbers, texts, None, and lists and mappings of these.
    library : str
        Module that the parser needs: it is imported before the child is forked.
    seconds : float
        Longest silence of the parser [s].
    n_bytes : int, optional
        Size that limits memory and time in place of the file's, if the parser reads
        other files too.

    Raises
    ------
    ParserEndedError
        A signal or a limit ended the child, or the parser raised anything else.
    MemoryError
        The file unpacks to more than its size allows.
    """
    size = _size(Path(path)) if n_bytes is None else n_bytes
    room = memory_for(size)
    request = _Request(
        parser=(parser.__module__, parser.__qualname__),
        arguments=[str(path), *arguments],
        library=library,
        room=room,
        seconds=seconds,
        cpu=int(_CPU + _CPU_BY_MIB * size / 2**20),
        folder=os.getcwd(),
    )
    if _is_single_threaded():
        return _answers(_fork_and_parse(request), room)
    return _answers(_ask_server(request), room)


def _size(path: Path) -> int:
    """Return the size of a file, or of all files of a folder [bytes]."""
    files = path.iterdir() if path.is_dir() else [path]
    return sum(file.stat().st_size for file in files)


def _is_single_threaded() -> bool:
    """Return whether this process has one thread, so that a fork is safe.

    With several threads a fork may copy a lock that another thread holds.
    """
    if sys.platform != "linux":
        return False
    with suppress(OSError):
        return len(os.listdir("/proc/self/task")) == 1
    return False


def _answers(messages: _Messages, room: int) -> Iterator[dict[str, Array]]:
    """Yield the arrays of a child's messages, of ``room`` bytes together at most; raise
    its errors and repeat its warnings.

    A message is a head and arrays. The head's key says what it is: "remark" (a
    warning), "what" (InputError with remedy and place), "not_installed", "memory",
    "failed"; a head without these comes with arrays.
    """
    with closing(messages):
        for head, arrays in messages:
            if "remark" in head:
                warnings.warn(str(head["remark"]), Remark, stacklevel=2)
            elif "what" in head:
                where = Path(head["where"]) if head["is_path"] else head["where"]
                raise InputError(str(head["what"]), str(head["remedy"]), where)
            elif "not_installed" in head:
                raise ImportError(str(head["not_installed"]))
            elif "memory" in head:
                raise MemoryError
            elif "failed" in head:
                raise ParserEndedError(str(head["failed"]))
            else:
                room -= sum(x.nbytes for x in arrays.values())
                if room < 0:
                    raise MemoryError
                yield dict(arrays)


def _fork_and_parse(request: _Request) -> _Messages:
    """Fork a child that runs the requested parser; yield its messages.

    The last message may say that it failed. The child is always waited for.
    """
    if request.library:
        importlib.import_module(request.library)
    function = _function(*request.parser)
    # What is buffered would otherwise be written by both processes.
    sys.stdout.flush()
    sys.stderr.flush()
    read_end, write_end = os.pipe()
    child = os.fork()
    if child == 0:
        _be_child(function, request, write_end)
    os.close(write_end)
    status = None  # until the child has ended and was waited for
    try:
        with open(read_end, "rb", buffering=0) as pipe:
            source = _Timed(pipe, request.seconds)
            while (message := _receive(source)) is not None:
                yield message
        status = os.waitpid(child, 0)[1]
        if os.WIFSIGNALED(status):
            yield {"failed": _reason(os.WTERMSIG(status))}, {}
    except TimeoutError:
        yield {"failed": f"its parser gave no answer for {request.seconds:g} s"}, {}
    finally:
        if status is None:
            with suppress(ProcessLookupError):
                os.kill(child, signal.SIGKILL)
            os.waitpid(child, 0)


def _reason(number: int) -> str:
    """Return why a signal has ended the parser, as a clause."""
    if number == signal.SIGXCPU:
        return "its parser took too long"
    return f"its parser was ended by {signal.Signals(number).name}"


def _function(module: str, name: str) -> Any:
    """Import a module's function by name."""
    return getattr(importlib.import_module(module), name)


def _be_child(
    function: Callable[..., Iterator[Arrays]], request: _Request, write_end: int
) -> None:
    """Run the parser in the forked child with limits, then end the process.

    Standard streams are closed and the pipe is file 3. ``os._exit`` keeps the child
    from finishing what belongs to the parent.
    """
    try:
        gc.disable()
        with suppress(OSError):  # the folder was removed
            os.chdir(request.folder)
        for number in (signal.SIGINT, signal.SIGTERM):
            signal.signal(number, signal.SIG_DFL)
        null_device = os.open(os.devnull, os.O_RDWR)
        for handle in range(3):
            os.dup2(null_device, handle)
        os.dup2(write_end, 3)
        os.closerange(4, os.sysconf("SC_OPEN_MAX"))
        _limit(request.cpu)
        _limit_memory(request.room)
        with open(3, "wb") as pipe:
            _send_answers(function, request.arguments, pipe)
    finally:
        os._exit(0)


def _send_answers(
    function: Callable[..., Iterator[Arrays]], arguments: Sequence[Any], pipe: BinaryIO
) -> None:
    """Send everything that a parser yields, warns of or raises, one message each."""

    def remark(message: Any, category: Any, *_: Any) -> None:
        """Send a warning of ours to the parent process; leave out others."""
        if issubclass(category, Remark):
            _send(pipe, {"remark": str(message)})

    with warnings.catch_warnings():
        warnings.simplefilter("always", Remark)
        warnings.showwarning = remark  # type: ignore[assignment]
        try:
            for arrays in function(*arguments):
                _send(pipe, {}, arrays)
        except InputError as error:
            is_path = isinstance(error.where, Path)
            where = None if error.where is None else str(error.where)
            place = {"where": where, "is_path": is_path}
            _send(pipe, {"what": error.what, "remedy": error.remedy, **place})
        except MemoryError:
            _send(pipe, {"memory": True})
        except Exception as error:
            first = (str(error).splitlines() or [type(error).__name__])[0]
            _send(pipe, {"failed": first[:200]})


def _limit_memory(room: int) -> None:
    """Limit the memory that this process may add [bytes], and the size of files that it
    may write.

    Memory-mapped files do not count. On systems without such limits nothing is limited.
    """
    try:  # private memory, as the limit counts it; the sixth figure is its pages
        pages = int(Path("/proc/self/statm").read_text("utf-8").split()[5])
    except OSError:  # not Linux
        return
    import resource

    used = pages * resource.getpagesize()
    for kind, allowed in (
        (resource.RLIMIT_DATA, used + room),
        (resource.RLIMIT_FSIZE, room),
    ):
        soft, hard = resource.getrlimit(kind)
        limits = [x for x in (allowed, soft, hard) if x != resource.RLIM_INFINITY]
        resource.setrlimit(kind, (min(limits), hard))


def _limit(cpu_seconds: int) -> None:
    """Limit this process: CPU time, open files, no core dump, no sockets, no other
    programs.
    """
    with suppress(ImportError, ValueError, OSError):
        import resource

        resource.setrlimit(resource.RLIMIT_CPU, (cpu_seconds, cpu_seconds + 1))
        resource.setrlimit(resource.RLIMIT_NOFILE, (_OPEN_FILES,) * 2)
        resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    _forbid_sockets_and_programs()


def _forbid_sockets_and_programs() -> None:
    """Install a seccomp filter in this process: such calls of the kernel fail (EPERM).

    Only on Linux, on architectures whose numbers are known. The process also ends with
    its parent.
    """
    # The kernel's number of the architecture, and of its calls socket, connect, bind,
    # execve, execveat, ptrace and io_uring_setup.
    forbidden = {
        "x86_64": (0xC000003E, (41, 42, 49, 59, 322, 101, 425)),
        "aarch64": (0xC00000B7, (198, 203, 200, 221, 281, 117, 425)),
    }
    architecture, calls = forbidden.get(platform.machine(), (0, ()))
    if sys.platform != "linux" or not calls:
        return
    # A program of the kernel's packet filter: an instruction has a code, the steps to
    # jump if true or false, and a value. It loads the architecture, then the call's
    # number, and compares.
    code = struct.Struct("HBBI")
    load = 0x20
    jump_equal = 0x15
    jump_above = 0x35
    answer = 0x06
    allow = 0x7FFF0000
    deny = 0x00050001  # with EPERM
    place_of_call = 0
    place_of_architecture = 4
    first_x32_call = 0x40000000  # the same calls under other numbers
    program = [
        code.pack(load, 0, 0, place_of_architecture),
        code.pack(jump_equal, 1, 0, architecture),
        code.pack(answer, 0, 0, deny),
        code.pack(load, 0, 0, place_of_call),
        code.pack(jump_above, len(calls) + 1, 0, first_x32_call),
    ]
    for k, call in enumerate(calls):
        program.append(code.pack(jump_equal, len(calls) - k, 0, call))
    program += [code.pack(answer, 0, 0, allow), code.pack(answer, 0, 0, deny)]
    text = ctypes.create_string_buffer(b"".join(program), 8 * len(program))
    head = struct.pack("HP", len(program), ctypes.addressof(text))
    kernel = ctypes.CDLL(None)
    # Options of prctl.
    end_with_parent = 1
    no_new_rights = 38
    set_filter = 22
    filter_mode = 2
    kernel.prctl(end_with_parent, signal.SIGKILL, 0, 0, 0)
    kernel.prctl(no_new_rights, 1, 0, 0, 0)
    kernel.prctl(set_filter, filter_mode, ctypes.c_char_p(head), 0, 0)


class _Timed:
    """A pipe whose reader waits only so long for the next bytes."""

    def __init__(self, pipe: Any, seconds: float) -> None:
        """Take a pipe and the longest time between two reads [s]."""
        self._pipe = pipe
        self._seconds = seconds

    def read_into(self, room: memoryview) -> int:
        """Fill ``room`` from the pipe; return the number of bytes, fewer if the pipe
        has ended.

        Raises TimeoutError if no bytes arrive in time.
        """
        n_read = 0
        end = time.monotonic() + self._seconds
        while n_read < len(room):
            if hasattr(select, "poll"):  # Windows waits without a limit
                poll = select.poll()
                poll.register(self._pipe, select.POLLIN)
                if not poll.poll(1000.0 * max(end - time.monotonic(), 0.0)):
                    raise TimeoutError
            n_bytes = self._pipe.readinto(room[n_read:])
            if not n_bytes:
                break
            n_read += n_bytes
            end = time.monotonic() + self._seconds
        return n_read


def _send(
    pipe: BinaryIO, head: Mapping[str, Any], arrays: Arrays | None = None
) -> None:
    """Send one message through a pipe: length of its head (8 bytes), the head as JSON,
    then the numbers of its arrays (little-endian doubles).

    The head's entry "arrays" lists their names and shapes, so that the receiver knows
    how much to read.
    """
    blocks = {
        name: np.ascontiguousarray(block, "<f8")
        for name, block in (arrays or {}).items()
    }
    shapes = [[name, list(block.shape)] for name, block in blocks.items()]
    text = json.dumps({**head, "arrays": shapes}).encode()
    pipe.write(struct.pack("<Q", len(text)) + text)
    for block in blocks.values():
        pipe.write(block.data.cast("B") if block.size else b"")
    pipe.flush()


def _receive(source: _Timed) -> tuple[dict[str, Any], Arrays] | None:
    """Read one message: head and arrays; None if the pipe has ended.

    Raises ParserEndedError for anything else: a parser that was taken over can send
    anything.
    """
    # The length of the head, the head as JSON, then each array's numbers.
    start = bytearray(8)
    if source.read_into(memoryview(start)) < len(start):
        return None
    (length,) = struct.unpack("<Q", start)
    if length > _HEAD:
        raise ParserEndedError("its parser sent no message")
    text = bytearray(length)
    if source.read_into(memoryview(text)) < length:
        return None
    arrays: dict[str, Array] = {}
    try:
        head = dict(json.loads(text))
        shapes = [(str(name), tuple(map(int, shape))) for name, shape in head["arrays"]]
    except (KeyError, TypeError, ValueError, RecursionError) as error:
        raise ParserEndedError("its parser sent no message") from error
    # Sizes are checked before memory is taken.
    for name, shape in shapes:
        n_bytes = 8 * int(np.prod([float(n) for n in shape]))
        if len(shape) > 3 or min(shape, default=0) < 0 or n_bytes > _ARRAY:
            raise ParserEndedError("its parser sent no array")
        block = np.empty(shape, "<f8")
        if block.size and source.read_into(block.data.cast("B")) < block.nbytes:
            return None
        arrays[name] = block
    return head, arrays


class _Server:
    """A process with one thread that forks the children of a process with several."""

    def __init__(self) -> None:
        """Start a Python process that waits for requests on its standard input and
        answers on its standard output (:func:`serve`)."""
        home = str(Path(__file__).parents[2])
        code = (
            f"import sys; sys.path.append({home!r});"
            " from sdp_vs_penalty.robot.isolated import serve; serve()"
        )
        options: Any = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE}
        command = [sys.executable, "-P", "-c", code]
        self.process = subprocess.Popen(command, bufsize=0, **options)
        self.owner = os.getpid()


#: Servers that do nothing; a call takes one of them, or starts one.
_idle: list[_Server] = []


def _idle_server() -> _Server:
    """Return an idle server that this process has started and that still runs; else
    start one.

    A process forked from this one inherits the list of idle servers, but must not share
    them.
    """
    while _idle:
        server = _idle.pop()
        if server.owner == os.getpid() and server.process.poll() is None:
            return server
    return _Server()


def _ask_server(request: _Request) -> _Messages:
    """Yield the messages of a child that an idle server forks for the request."""
    server = _idle_server()
    is_done = False
    try:
        server.process.stdin.write(json.dumps(asdict(request)).encode() + b"\n")  # type: ignore[union-attr]
        # The server itself ends a silent parser; it takes seconds to start.
        source = _Timed(server.process.stdout, request.seconds + 30.0)
        message = _receive(source)
        while message is not None:
            if "end" in message[0]:
                is_done = True
                return
            # Received before this one is handed on: after an error nobody asks for more.
            following = _receive(source)
            is_done = following is not None and "end" in following[0]
            yield message
            message = following
        yield {"failed": "its parser has ended"}, {}
    except (BrokenPipeError, TimeoutError):
        yield {"failed": "its parser has ended"}, {}
    finally:
        if is_done:
            _idle.append(server)
        else:  # what it still sends would answer the next request
            server.process.kill()
            server.process.wait()


def serve() -> None:
    """Serve requests (a line of JSON each on stdin) until stdin ends, with messages on
    stdout.
    """
    pipe = sys.stdout.buffer
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    for line in sys.stdin.buffer:
        request = _Request(**json.loads(line))
        if hasattr(os, "fork"):
            try:
                for head, arrays in _fork_and_parse(request):
                    _send(pipe, head, arrays)
            except ImportError as error:
                _send(pipe, {"not_installed": str(error)})
        else:  # a broken file ends this server, and the next call starts another one
            function = _function(*request.parser)
            _send_answers(function, request.arguments, pipe)
        _send(pipe, {"end": True})
