"""Servers for the tests.

RHUMB_TEST_SERVER names the program; the tests of the workspace set it.
"""

import os
import re
import subprocess

import pytest

import rhumb


class Server:
    """A server process of its own, on a free port of this machine; of `words`: an edge."""

    def __init__(self, *words):
        command = [os.environ["RHUMB_TEST_SERVER"], *(words or ["--open"]), "--listen", "127.0.0.1:0", "--log", "off"]
        self.process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
        self.address = self.fingerprint = None
        while self.address is None or self.fingerprint is None:
            line = self.process.stdout.readline()
            assert line, "the server ended before it listened"
            if line.startswith("listening on "):
                self.address = line.removeprefix("listening on ").strip()
            if line.startswith("fingerprint "):
                self.fingerprint = line.removeprefix("fingerprint ").strip()

    def connect(self, **options):
        return rhumb.connect(self.address, fingerprint=self.fingerprint, **options)

    def end(self):
        self.process.kill()
        self.process.wait()
        self.process.stdout.close()


@pytest.fixture(scope="session")
def server():
    one = Server()
    yield one
    one.end()


@pytest.fixture(scope="session")
def divided():
    """A server that divides its scenes into columns of ten metres."""
    one = Server("--open", "--cells", "10")
    yield one
    one.end()


@pytest.fixture
def own_server():
    """A server that the test may end."""
    one = Server()
    yield one
    one.end()


@pytest.fixture
def edge():
    """Starts an edge of a server."""
    edges = []

    def start(address):
        owner, fingerprint = address.split("#")
        edges.append(Server("edge", "--owner", owner, "--fingerprint", fingerprint))
        return edges[-1]

    yield start
    for one in edges:
        one.end()


@pytest.fixture
def scene(server, request):
    """A new scene under the name of the test."""
    name = re.sub("[^a-zA-Z0-9]+", "-", request.node.name)[-64:]
    with server.connect().join(name, condition="create") as one:
        yield one
