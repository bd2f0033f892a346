"""A live scene with client.py and the Rust client: both hold the same bits at every tick that both have.

Usage: python3 check_live.py RHUMB-SERVER RHUMB-FOLLOW [BODIES [TICKS]]. Needs what client.py needs. It starts the server
and the leader of a ball pit, joins while the scene runs, and compares the files that both write. The server asks for tokens:
the leader owns the scene, and the other client observes it.
"""

import json
import subprocess
import sys
import tempfile
from pathlib import Path

HERE = Path(__file__).resolve().parent
MICROMETRES = 10000


def start(arguments, **named):
    return subprocess.Popen([str(one) for one in arguments], stdout=subprocess.PIPE, text=True, **named)


def server_of(process):
    """The server's address and the fingerprint to pin."""
    found = {}
    while len(found) < 2:
        line = process.stdout.readline()
        if not line:
            raise SystemExit("the server ended before it listened")
        for start_of in ("listening on ", "fingerprint "):
            if line.startswith(start_of):
                found[start_of] = line[len(start_of) :].strip()
    return found["listening on "], found["fingerprint "]


def expect(process, word):
    line = process.stdout.readline().strip()
    if not line.startswith(word):
        raise SystemExit(f"expected {word!r}, received {line!r}")
    return line


def tokens(server_path, folder):
    """Makes a key and two tokens; returns the paths of the public key, of the leader's token and of the observer's."""
    key = folder / "key"
    subprocess.run([server_path, "token", "--new-key", key], check=True, stdout=subprocess.DEVNULL)
    files = []
    for role in ("owner", "observer"):
        mint = [server_path, "token", "--key", key, "--client", role, "--scene", "live", "--role", role]
        token = subprocess.run(mint, check=True, capture_output=True, text=True).stdout
        files.append(folder / f"{role}.token")
        files[-1].write_text(token, encoding="ascii")
    return [folder / "key.pub", *files]


def run(folder, server_path, follow_path, bodies, ticks):
    address = None
    processes = []
    try:
        key, leads, observes = tokens(server_path, folder)
        server = start([server_path, "--token-key", key, "--listen", "127.0.0.1:0"])
        processes.append(server)
        address, fingerprint = server_of(server)
        common = ["--server", address, "--fingerprint", fingerprint, "--scene", "live", "--micrometres", MICROMETRES]
        rust = [follow_path, *common, "--bodies", bodies, "--ticks", ticks, "--out", folder / "rust.jsonl", "--token", leads]
        leader = start(rust, stdin=subprocess.PIPE)
        processes.append(leader)
        expect(leader, "going")
        python = [sys.executable, HERE / "client.py", *common, "--until", ticks, "--out", folder / "python.jsonl"]
        python += ["--token", observes]
        python_client = start(python)
        processes.append(python_client)
        expect(python_client, "joined")
        leader.stdin.write("\n")
        leader.stdin.flush()
        expect(leader, "done")
        print(expect(python_client, "followed"))
        leader.stdin.close()
        return python_client.wait(timeout=20) + leader.wait(timeout=20)
    finally:
        for process in processes:
            process.kill()
            process.wait()


def lines(path):
    return {line["tick"]: line for line in map(json.loads, path.read_text(encoding="utf-8").splitlines())}


def main():
    server_path, follow_path = Path(sys.argv[1]), Path(sys.argv[2])
    bodies, ticks = (int(sys.argv[place]) if len(sys.argv) > place else most for place, most in ((3, 200), (4, 300)))
    with tempfile.TemporaryDirectory() as folder:
        failed = run(Path(folder), server_path, follow_path, bodies, ticks)
        rust, python = lines(Path(folder) / "rust.jsonl"), lines(Path(folder) / "python.jsonl")
    both = sorted(rust.keys() & python.keys())
    wrong = [tick for tick in both if rust[tick] != python[tick]]
    poses = sum(len(rust[tick]["moving"]) for tick in both)
    print(f"{len(both)} ticks held by both, {poses} motions, {len(wrong)} ticks differ")
    for tick in wrong[:5]:
        one, other = rust[tick]["moving"], python[tick]["moving"]
        differ = [name for name in one.keys() | other.keys() if one.get(name) != other.get(name)]
        print(f"tick {tick}: checksums {rust[tick]['checksum']} and {python[tick]['checksum']}, bodies {sorted(differ)[:5]}")
    # The Python client joins after some ticks, and may miss some ticks that later ones have overtaken.
    few = len(both) < ticks // 2 or ticks not in both
    return 1 if failed or wrong or few or not poses else 0


if __name__ == "__main__":
    sys.exit(main())
