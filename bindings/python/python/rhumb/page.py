"""The page that shows a scene in a browser."""

import webbrowser

from ._native import Scene

__all__ = ["view"]


def view(scene: Scene, *, browser: bool = True) -> str:
    """Opens the page that shows a scene, and returns its address.

    The scene is one of serve, local or LocalServer; its page ends with it. Without a browser on this machine, or with
    browser=False, only the address is returned. What is queued is sent first. The page shows what the scene does from then
    on: it steps nothing.
    """
    address = scene.page()
    if browser:
        webbrowser.open(address)
    return address
