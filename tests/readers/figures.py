#!/usr/bin/env python3
"""Prints a server's figures once a scene is among them, and checks that a dashboard asks for figures that exist.

Usage: figures.py URL DASHBOARD
"""

import json
import re
import sys
import time
import urllib.request

url, dashboard = sys.argv[1:]
deadline = time.monotonic() + 20
while True:
    with urllib.request.urlopen(url, timeout=5) as answer:
        text = answer.read().decode()
    if 'rhumb_scene_tick{scene="' in text or time.monotonic() > deadline:
        break
    time.sleep(0.02)
assert 'rhumb_scene_tick{scene="' in text, "no scene has figures"

names = {line.split()[2] for line in text.splitlines() if line.startswith("# TYPE ")}
for needed in ("rhumb_build_info", "process_cpu_seconds_total", "process_resident_memory_bytes", "process_open_fds"):
    assert needed in names, f"{needed} is missing"
with open(dashboard, encoding="utf-8") as file:
    asked = re.findall(r"\b(?:rhumb|process)_\w+", " ".join(
        target["expr"] for panel in json.load(file)["panels"] for target in panel["targets"]
    ))
for name in set(asked):
    base = re.sub(r"_(bucket|sum|count)$", "", name)
    assert name in names or base in names, f"the dashboard asks for {name}, which no server has"
sys.stdout.write(text)
