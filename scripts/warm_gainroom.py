"""gainroom's commands from a process that has imported everything once: for the dozens of commands of the documentation.

    python scripts/warm_gainroom.py serve SOCKET             runs what is asked for, until its standard input ends
    python scripts/warm_gainroom.py call SOCKET ARGUMENTS    as `gainroom ARGUMENTS`, with the caller's streams, folder and environment

Each command runs in a process of its own, forked from one that has imported and computed nothing: only the start is another.
"""

import json
import os
import select
import signal
import socket
import sys

SIZE = 1 << 20
"""Maximum size of a request [bytes]: arguments, folder and environment."""


def call(path: str, arguments: list[str]) -> int:
    """The exit status of the command, which writes to this process's streams."""
    request = json.dumps([arguments, os.getcwd(), dict(os.environ)]).encode()
    with socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET) as connection:
        connection.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, SIZE)
        connection.connect(path)
        socket.send_fds(connection, [request], [0, 1, 2])
        return int(connection.recv(16) or b"2")


def serve(path: str) -> None:
    """Serves requests until standard input ends."""
    with socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET) as listener:
        listener.bind(path)
        listener.listen()
        load()
        signal.signal(signal.SIGCHLD, signal.SIG_IGN)  # nobody waits for those who wait
        while listener in select.select([listener, sys.stdin], [], [])[0]:
            connection, _ = listener.accept()
            if os.fork() == 0:
                signal.signal(signal.SIGCHLD, signal.SIG_DFL)
                listener.close()
                answer(connection)
                os._exit(0)
            connection.close()


def load() -> None:
    """Imports all modules that any command imports, except those that only run in other processes, or in a trainer."""
    import importlib
    import pkgutil

    import gainroom.cli  # before numpy: it says how many threads

    for module in pkgutil.walk_packages(gainroom.__path__, "gainroom."):
        if not module.name.startswith(("gainroom.app", "gainroom.__main__", "gainroom.trainers.")):
            importlib.import_module(module.name)
    for name in ("mujoco", "pinocchio", "scipy.optimize", "scipy.signal"):
        importlib.import_module(name)


def answer(connection: socket.socket) -> None:
    """Run one command in a new process, and send its status once it has ended."""
    request, streams, _, _ = socket.recv_fds(connection, SIZE, 3)
    pid = os.fork()
    if pid == 0:
        connection.close()
        for number, stream in enumerate(streams):
            os.dup2(stream, number)
            os.close(stream)
        # Streams remember what they were opened on.
        sys.stdin, sys.stdout, sys.stderr = (os.fdopen(number, mode, encoding="utf-8", closefd=False) for number, mode in enumerate("rww"))
        sys.__stdin__, sys.__stdout__, sys.__stderr__ = sys.stdin, sys.stdout, sys.stderr
        arguments, folder, environment = json.loads(request)
        os.chdir(folder)
        os.environ.clear()
        os.environ.update(environment)
        sys.argv = ["gainroom", *arguments]
        from gainroom.cli import main

        sys.exit(main())
    connection.send(str(os.waitstatus_to_exitcode(os.waitpid(pid, 0)[1])).encode())


if __name__ == "__main__":
    if sys.argv[1] == "call":
        sys.exit(call(sys.argv[2], sys.argv[3:]))
    serve(sys.argv[2])
