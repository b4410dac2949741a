"""The command that opens the live page: `explore`."""

import webbrowser
from typing import Annotated

from mishutter._core.progress import note
from mishutter.cli.console import print_text, start_jax
from mishutter.cli.options import SceneArgument, option


def explore(
    scene_file: SceneArgument = None,
    port: Annotated[
        int,
        option(None, "--port PORT", "Port to listen at; 0 takes any free port.", min=0, max=65535),
    ] = 0,
    host: Annotated[
        str,
        option(
            None,
            "--host ADDRESS",
            "Address to listen at; the default is reachable from this machine only.",
        ),
    ] = "127.0.0.1",
    no_browser: Annotated[
        bool, option(None, "--no-browser", "Print the page's address without opening a browser.")
    ] = False,
) -> None:
    """Open a page with sliders on which the design follows the scene."""
    try:
        import tornado  # noqa: F401 - only this command needs it
    except ImportError:
        raise ValueError(
            "`explore` must find the package tornado; got none: pip install 'mishutter[explore]'."
        ) from None
    start_jax()
    from mishutter.explore.server import serve
    from mishutter.explore.session import beginning

    def ready(address: str) -> None:
        print_text(address)
        if not no_browser:
            webbrowser.open(address)

    started = beginning(scene_file)
    if host not in ("127.0.0.1", "localhost", "::1"):
        note(f"anyone who reaches {host} can use this page")
    serve(started, host=host, port=port, ready=ready, note=note)
