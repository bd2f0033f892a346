#!/usr/bin/env python3
"""Tries three stores as the place that says which server has a scene: etcd, NATS KV, Postgres.

    apt-get install etcd-server nats-server postgresql
    pip install nats-py 'psycopg[binary]'
    python3 tests/stores/trial.py                 # some three minutes; prints one table
    python3 tests/stores/trial.py --leases 3      # fewer expiries

Each store runs alone, on loopback, with its files in a temporary folder, and does for one scene what a directory needs:

- *claim*: makes the scene's entry if there is none, and gets a number that grows with each claim (the epoch);
- *renew*: says that the owner lives, under a lease of 2 s;
- *watch*: tells another connection that an entry came (milliseconds after the claim was answered; below 0 is before);
- *expiry*: an owner that says nothing more loses the scene. *noticed* is when a watcher notices it by itself, *free* is when
  another's claim is taken, tried every 20 ms; both in seconds after the last renewal. The lease counts from there;
- *late*: what a renewal of the old owner does after another has the scene. It must be refused;
- *kill -9*: the store is killed and started again: the entries that it had acknowledged must be there.

etcd is asked by its JSON gateway, as the server does; the others by the clients of their makers. Postgres has no leases: rows
have times, which statements compare with the store's clock. On failure the exit code is 1.
"""

import argparse
import asyncio
import base64
import contextlib
import http.client
import json
import os
import pathlib
import pwd
import shutil
import signal
import socket
import statistics
import subprocess
import sys
import tempfile
import threading
import time
import urllib.error
import urllib.request

LEASE = 2
POSTGRES = pathlib.Path("/usr/lib/postgresql/15/bin")


def free_port():
    with socket.socket() as one:
        one.bind(("127.0.0.1", 0))
        return one.getsockname()[1]


def started(command, folder, **options):
    log = open(folder / "log", "ab")
    return subprocess.Popen([str(word) for word in command], stdout=log, stderr=log, **options)


def memory_mb(pid):
    """Resident memory of a process and its children."""
    total = 0
    for status in pathlib.Path("/proc").glob("[0-9]*/status"):
        try:
            fields = dict(line.split(":", 1) for line in status.read_text().splitlines() if ":" in line)
        except OSError:
            continue
        if int(fields["Pid"]) == pid or int(fields["PPid"]) == pid:
            total += int(fields.get("VmRSS", "0 kB").split()[0])
    return total / 1024


def answered_by_etcd(port, path, body):
    request = urllib.request.Request(f"http://127.0.0.1:{port}/v3/{path}", json.dumps(body).encode())
    with urllib.request.urlopen(request, timeout=10) as answer:
        return json.loads(answer.readline())


def base(text):
    return base64.b64encode(text.encode()).decode()


class Etcd:
    """A key under a lease, made by a transaction; its creation revision is the epoch."""

    name = "etcd"

    def __init__(self, folder):
        self.folder, self.port, self.peers = folder, free_port(), free_port()

    def start(self):
        client, peer = f"http://127.0.0.1:{self.port}", f"http://127.0.0.1:{self.peers}"
        command = ["etcd", "--data-dir", self.folder / "data", "--listen-client-urls", client, "--advertise-client-urls", client]
        command += ["--listen-peer-urls", peer, "--initial-advertise-peer-urls", peer, "--initial-cluster", f"default={peer}"]
        return started(command, self.folder)

    async def ask(self, path, **body):
        return await asyncio.to_thread(answered_by_etcd, self.port, path, body)

    async def connect(self):
        await self.ask("kv/range", key=base("scene"))
        return self

    async def close(self):
        pass

    async def claim(self, scene, owner):
        lease = (await self.ask("lease/grant", TTL=LEASE))["ID"]
        put = {"requestPut": {"key": base(scene), "value": base(owner), "lease": lease}}
        none = {"key": base(scene), "target": "CREATE", "createRevision": 0}
        answer = await self.ask("kv/txn", compare=[none], success=[put])
        if not answer.get("succeeded"):
            await self.ask("lease/revoke", ID=lease)
            return None
        return int(answer["header"]["revision"]), lease

    async def renew(self, scene, owner, claim):
        answer = await self.ask("lease/keepalive", ID=claim[1])
        if int(answer["result"].get("TTL", 0)) <= 0:
            raise LookupError("the lease is over")
        return claim

    async def owner(self, scene):
        found = (await self.ask("kv/range", key=base(scene))).get("kvs")
        return base64.b64decode(found[0]["value"]).decode() if found else None

    async def watch(self, scene, notice):
        def lines():
            watch = {"create_request": {"key": base(scene)}}
            request = urllib.request.Request(f"http://127.0.0.1:{self.port}/v3/watch", json.dumps(watch).encode())
            with urllib.request.urlopen(request, timeout=60) as answer:
                for line in answer:
                    result = json.loads(line)["result"]
                    if result.get("created"):
                        loop.call_soon_threadsafe(ready.set)
                    for event in result.get("events", []):
                        loop.call_soon_threadsafe(notice, "gone" if event.get("type") == "DELETE" else "came")

        def until_it_ends():
            # The store is killed on purpose, and no event is waited for after the loop has ended.
            with contextlib.suppress(OSError, http.client.HTTPException, RuntimeError):
                lines()

        loop, ready = asyncio.get_running_loop(), asyncio.Event()
        # A thread of its own: those of a pool would wait for lines until none is left for requests.
        threading.Thread(target=until_it_ends, daemon=True).start()
        self.task = loop.create_future()
        await ready.wait()


class Nats:
    """A key of a bucket whose age limit is the lease of all; its revision is the epoch."""

    name = "NATS KV"

    def __init__(self, folder):
        self.folder, self.port = folder, free_port()

    def start(self):
        (self.folder / "conf").write_text(f"jetstream {{ store_dir: {json.dumps(str(self.folder / 'data'))} }}\n")
        return started(["nats-server", "-a", "127.0.0.1", "-p", self.port, "-c", self.folder / "conf"], self.folder)

    async def connect(self):
        import nats

        one = Nats(self.folder)
        one.port = self.port

        async def unheard(_error):
            """The store is killed on purpose; what fails is raised where it is asked."""

        address = f"nats://127.0.0.1:{self.port}"
        one.link = await nats.connect(address, allow_reconnect=False, reconnect_time_wait=0.05, error_cb=unheard)
        one.keys = await one.link.jetstream().create_key_value(bucket="scenes", ttl=LEASE, history=1)
        return one

    async def close(self):
        await self.link.close()

    async def claim(self, scene, owner):
        from nats.js.errors import KeyNotFoundError, KeyWrongLastSequenceError

        try:
            epoch = await self.keys.create(scene, owner.encode())
        except (KeyWrongLastSequenceError, KeyNotFoundError):
            # The client reads the key whose making was refused; it may have aged out in between.
            return None
        return epoch, epoch

    async def renew(self, scene, owner, claim):
        from nats.js.errors import KeyWrongLastSequenceError

        try:
            return claim[0], await self.keys.update(scene, owner.encode(), last=claim[1])
        except KeyWrongLastSequenceError as cause:
            raise LookupError("another revision") from cause

    async def owner(self, scene):
        from nats.js.errors import KeyNotFoundError

        try:
            return (await self.keys.get(scene)).value.decode()
        except KeyNotFoundError:
            return None

    async def watch(self, scene, notice):
        async def updates():
            async for update in watcher:
                if update is not None:
                    notice("came" if update.operation is None else "gone")

        watcher = await self.keys.watch(scene)
        self.task = asyncio.ensure_future(updates())


class Postgres:
    """A row with a time; a number of a sequence is the epoch; notices by LISTEN."""

    name = "Postgres"

    def __init__(self, folder):
        self.folder, self.port = folder, free_port()

    def command(self, word):
        """The server refuses to run as root."""
        return (["setpriv", "--reuid=postgres", "--regid=postgres", "--clear-groups"] if os.getuid() == 0 else []) + [POSTGRES / word]

    def start(self):
        data = self.folder / "data"
        if not data.exists():
            if os.getuid() == 0:
                user = pwd.getpwnam("postgres")
                os.chown(self.folder, user.pw_uid, user.pw_gid)
            init = [*self.command("initdb"), "--auth=trust", "-U", "trial", "-D", data]
            subprocess.run([str(word) for word in init], check=True, stdout=subprocess.DEVNULL)
        command = [*self.command("postgres"), "-D", data, "-h", "127.0.0.1", "-p", self.port, "-k", self.folder]
        return started(command, self.folder)

    async def connect(self):
        import psycopg

        one = Postgres(self.folder)
        address = f"host=127.0.0.1 port={self.port} user=trial dbname=postgres"
        one.link = await psycopg.AsyncConnection.connect(address, autocommit=True)
        await one.link.execute("CREATE SEQUENCE IF NOT EXISTS epochs")
        await one.link.execute(
            "CREATE TABLE IF NOT EXISTS scenes (scene text PRIMARY KEY, owner text, epoch bigint, until timestamptz)"
        )
        return one

    async def close(self):
        await self.link.close()

    async def changed(self, statement, *values):
        return await (await self.link.execute(statement, values)).fetchone()

    async def claim(self, scene, owner):
        row = await self.changed(
            f"""INSERT INTO scenes VALUES (%s, %s, nextval('epochs'), clock_timestamp() + '{LEASE} s')
            ON CONFLICT (scene) DO UPDATE SET owner = excluded.owner, epoch = excluded.epoch, until = excluded.until
            WHERE scenes.until < clock_timestamp() RETURNING epoch""",
            scene,
            owner,
        )
        if row is None:
            return None
        await self.link.execute("SELECT pg_notify('scenes', %s)", [scene])
        return row[0], row[0]

    async def renew(self, scene, owner, claim):
        row = await self.changed(
            f"""UPDATE scenes SET until = clock_timestamp() + '{LEASE} s'
            WHERE scene = %s AND epoch = %s AND until > clock_timestamp() RETURNING epoch""",
            scene,
            claim[0],
        )
        if row is None:
            raise LookupError("no row with this epoch")
        return claim

    async def owner(self, scene):
        row = await self.changed("SELECT owner FROM scenes WHERE scene = %s", scene)
        return row and row[0]

    async def watch(self, scene, notice):
        async def notices():
            async for each in self.link.notifies():
                if each.payload == scene:
                    notice("came")

        await self.link.execute("LISTEN scenes")
        self.task = asyncio.ensure_future(notices())


async def connected(store, seconds=30):
    """Connects as soon as the store answers."""
    end = time.monotonic() + seconds
    while True:
        try:
            return await store.connect()
        except Exception as cause:
            if time.monotonic() > end:
                raise RuntimeError(f"{store.name} does not answer: {cause}; see {store.folder / 'log'}") from cause
            await asyncio.sleep(0.05)


async def timed(times, coroutine):
    since = time.monotonic()
    result = await coroutine
    times.append(1000 * (time.monotonic() - since))
    return result


async def requests(store, count):
    """Milliseconds of claims and renewals, one after the other, and of the watcher's delay."""
    one, other = await connected(store), await connected(store)
    came = asyncio.Event()
    seen = []

    def notice(_what):
        seen.append(time.monotonic())
        came.set()

    claims, renewals, delays = [], [], []
    await other.watch("watched", notice)
    await one.claim("watched", "a")
    answered = time.monotonic()
    await asyncio.wait_for(came.wait(), 10)
    delays.append(1000 * (seen[0] - answered))
    for number in range(count):
        claim = await timed(claims, one.claim(f"scene{number}", "a"))
        assert claim is not None, f"{store.name}: a free scene was refused"
        assert await one.claim(f"scene{number}", "b") is None, f"{store.name}: a scene has two owners"
        await timed(renewals, one.renew(f"scene{number}", "a", claim))
    other.task.cancel()
    await one.close()
    return claims, renewals, delays


async def expiry(store, number):
    """Seconds until a watcher notices (or `None`) and until another's claim is taken; whether a late renewal is refused."""
    one, other, watcher = [await connected(store) for _ in range(3)]
    scene, noticed = f"expiring{number}", []
    claim = await one.claim(scene, "a")
    await watcher.watch(scene, lambda what: noticed.append(time.monotonic()) if what == "gone" else None)
    await asyncio.sleep(LEASE / 3)
    since = time.monotonic()
    claim = await one.renew(scene, "a", claim)
    while (taken := await other.claim(scene, "b")) is None:
        await asyncio.sleep(0.02)
    free = time.monotonic() - since
    assert taken[0] > claim[0], f"{store.name}: the epoch does not grow"
    try:
        await one.renew(scene, "a", claim)
        refused = False
    except (LookupError, urllib.error.HTTPError):
        refused = True
    assert await other.owner(scene) == "b"
    watcher.task.cancel()
    for each in [one, other, watcher]:
        await each.close()
    return noticed[0] - since if noticed else None, free, refused


async def trial(store, arguments):
    process = store.start()
    try:
        claims, renewals, delays = await requests(store, arguments.claims)
        memory = memory_mb(process.pid)
        expiries = [await expiry(store, number) for number in range(arguments.leases)]
        one = await connected(store)
        await one.claim("kept", "a")
        process.send_signal(signal.SIGKILL)
        process.wait()
        since = time.monotonic()
        process = store.start()
        one = await connected(store)
        back = time.monotonic() - since
        kept = await one.owner("kept") == "a"
        await one.close()
    finally:
        process.terminate()
        process.wait()
    noticed = [noticed for noticed, _, _ in expiries if noticed is not None]
    free = [free for _, free, _ in expiries]
    spread = lambda values: f"{min(values):.2f} to {max(values):.2f}" if values else "never"
    share = lambda values: f"{statistics.median(values):.2f} / {statistics.quantiles(values, n=100)[98]:.2f}"
    late = "refused" if all(refused for _, _, refused in expiries) else "**taken**"
    cells = [store.name, share(claims), share(renewals), f"{delays[0]:.2f}", spread(noticed), spread(free), late]
    return [*cells, f"{'kept' if kept else '**lost**'}, {back:.2f} s", f"{memory:.0f}"]


HEAD = ["store", "claim ms, p50 / p99", "renew ms", "watch ms", "noticed s", "free s", "late", "kill -9", "MB"]


def main():
    parser = argparse.ArgumentParser(description=__doc__.split("\n\n")[0])
    parser.add_argument("--claims", type=int, default=200, help="claims and renewals [default: 200]")
    parser.add_argument("--leases", type=int, default=10, help="expiries of leases [default: 10]")
    arguments = parser.parse_args()
    print("| " + " | ".join(HEAD) + " |\n|" + "---|" * len(HEAD))
    for kind in [Etcd, Nats, Postgres]:
        folder = pathlib.Path(tempfile.mkdtemp(prefix="rhumb-store-"))
        try:
            print("| " + " | ".join(asyncio.run(trial(kind(folder), arguments))) + " |", flush=True)
        except (AssertionError, RuntimeError, OSError, subprocess.SubprocessError) as cause:
            print(f"{kind.name}: {cause}", file=sys.stderr)
            return 1
        finally:
            shutil.rmtree(folder)
    return 0


if __name__ == "__main__":
    sys.exit(main())
