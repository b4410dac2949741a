"""The server of the page: for this machine alone, one state a tab, the latest request wins."""

import asyncio
import io
import json
import tomllib

import numpy as np
import pytest
import tornado.httpclient
import tornado.httpserver
import tornado.netutil
import tornado.websocket
from PIL import Image
from support.command_line import SMALL_SCENE

# The face starts a server that never returns; these tests run it on a loop of their own.
from mishutter.explore import server
from mishutter.explore.session import Beginning, with_design

TABLES = tomllib.loads(SMALL_SCENE.replace('path = "photo.png"', "mean_level = 0.23"))
del TABLES["motion"]
KINDS = ("pin", "unpin")
_PATIENCE = 240
"""For an answer of a machine that is busy; s."""
TABS = []
"""Connections to be closed."""


@pytest.fixture(scope="module")
def started():
    return with_design(Beginning(TABLES, {}), lambda step, value: None)


def served(started, talk, host="127.0.0.1", **options):
    """What `talk` returns, called with the port of a server that is warm."""

    async def run():
        explorer = server.Explorer(started, lambda text: None)
        explorer.is_warm.set()
        application = server.application(explorer, server.known_hosts(host))
        http = tornado.httpserver.HTTPServer(application)
        sockets = tornado.netutil.bind_sockets(0, "127.0.0.1")
        http.add_sockets(sockets)
        try:
            return await asyncio.wait_for(talk(sockets[0].getsockname()[1]), _PATIENCE)
        finally:
            http.stop()
            while TABS:
                TABS.pop().close()
            await asyncio.sleep(0.1)
            await http.close_all_connections()
            explorer.quick.shutdown()
            explorer.slow.shutdown()

    return asyncio.run(run())


async def fetched(port, path="/", **headers):
    client = tornado.httpclient.AsyncHTTPClient()
    return await client.fetch(f"http://127.0.0.1:{port}{path}", headers=headers, raise_error=False)


async def connected(port, key="", **headers):
    headers = {"Origin": f"http://127.0.0.1:{port}"} | headers
    address = f"ws://127.0.0.1:{port}/tab?key={key}"
    request = tornado.httpclient.HTTPRequest(address, headers=headers)
    TABS.append(await tornado.websocket.websocket_connect(request))
    return TABS[-1]


async def received(tab, kind):
    while (text := await tab.read_message()) is not None:
        message = json.loads(text)
        if message["kind"] == kind:
            return message
        assert message["kind"] != "error", message["text"]
    return None


def photograph_file():
    """A picture of uneven grey, as a file's bytes."""
    buffer = io.BytesIO()
    grey = np.random.default_rng(3).integers(30, 220, (20, 90), dtype=np.uint8)
    Image.fromarray(grey).save(buffer, "PNG")
    return buffer.getvalue()


def asked(number, light=2.3e5):
    scene = TABLES | {"light": {"photon_rate_per_s": light}}
    return json.dumps({"kind": "design", "id": number, "scene": scene})


def test_the_page_loads_from_this_machine_alone(started):
    """Every file is served, may load from its own server only, and names no other."""
    paths = ("/", "/explore.js", "/charts.js", "/explore.css", "/icon.svg")

    async def talk(port):
        return [await fetched(port, path) for path in paths]

    for path, answer in zip(paths, served(started, talk), strict=True):
        assert answer.code == 200, path
        assert answer.headers["Content-Security-Policy"].startswith("default-src 'self';"), path
        text = answer.body.decode().replace("http://www.w3.org/2000/svg", "")
        assert "http://" not in text, path
        assert "https://" not in text, path


def test_a_request_by_another_name_is_refused(started):
    """A site that points its name to this machine gets nothing."""
    names = ("127.0.0.1", "localhost:80", "evil.example", "10.0.0.7")

    async def talk(port):
        return [
            (await fetched(port, path, Host=name)).code
            for path in ("/", "/other")
            for name in names
        ]

    assert served(started, talk) == [200, 200, 403, 403, 404, 404, 403, 403]


@pytest.mark.parametrize(
    ("host", "name", "known"),
    [
        ("127.0.0.1", "127.0.0.1", True),
        ("127.0.0.1", "LOCALHOST", True),
        ("127.0.0.1", "192.168.1.5", False),
        ("192.168.1.5", "192.168.1.5", True),
        ("0.0.0.0", "192.168.1.5", True),
        ("0.0.0.0", "evil.example", False),
        ("::", "fe80::1", True),
        ("127.0.0.1", "*", False),
        ("127.0.0.1", None, False),
    ],
)
def test_hosts_are_those_that_the_option_names(host, name, known):
    """Where all addresses are served any address is known, but no name of another site."""
    assert server.is_known(name, server.known_hosts(host)) == known


def test_a_connection_from_another_site_is_refused(started):
    """The origin of a connection is the page itself, not one that ends or begins like it."""

    async def talk(port):
        codes = []
        other = {"Origin": "http://evil.example", "Host": "evil.example"}
        own = f"127.0.0.1:{port}"
        origins = (
            *("http://evil.example", f"http://localhost:{port}", "null", "http://[x", ""),
            *(f"http://evil.{own}", f"http://evil{own}", f"http://evil.example/http://{own}"),
            *(f"http://{own}.evil.example", f"http://{own}0", f"https://{own}", own),
        )
        for headers in (other, *({"Origin": origin} for origin in origins)):
            try:
                await connected(port, **headers)
            except tornado.httpclient.HTTPClientError as error:
                codes.append(error.code)
        return codes

    assert served(started, talk) == [403] * 13


@pytest.mark.slow
def test_the_latest_request_wins(started):
    """Of many requests at once the last is answered, and most of the others never."""

    async def talk(port):
        tab = await connected(port)
        await received(tab, "hello")
        for number in range(1, 40):
            await tab.write_message(asked(number, light=2.3e5 - 1e3 * number))
        ids = []
        while not ids or ids[-1] < 39:
            ids.append((await received(tab, "first"))["id"])
        return ids

    ids = served(started, talk)
    assert ids == sorted(ids)
    assert len(ids) < 10


@pytest.mark.slow
def test_tabs_do_not_share_state(started):
    """A pin of one tab is none of another, and each is answered for its own scene."""

    async def talk(port):
        tabs = [await connected(port) for _ in range(2)]
        await tabs[0].write_message(json.dumps({"kind": "pin", "name": "mine"}))
        await tabs[1].write_message(json.dumps({"kind": "unpin", "name": "x"}))
        pins = [(await received(tab, kind))["pins"] for tab, kind in zip(tabs, KINDS, strict=True)]
        for number, tab in enumerate(tabs):
            await tab.write_message(asked(7, light=2.3e5 / (1 + number)))
        answers = [await received(tab, "first") for tab in tabs]
        return pins, [a["curves"]["optimised"]["numbers"]["psnr"] for a in answers]

    pins, levels = served(started, talk)
    assert pins == [["mine"], []]
    assert levels[0] > levels[1] + 0.1


def test_a_tab_that_is_loaded_again_has_its_pins_and_photograph(started):
    """By the key that it was given; another key begins anew, and no key is given twice."""

    async def talk(port):
        tab = await connected(port)
        first = await received(tab, "hello")
        await tab.write_message(json.dumps({"kind": "pin", "name": "mine"}))
        await received(tab, "pin")
        await tab.write_message(json.dumps({"kind": "upload", "name": "mine.png"}))
        await tab.write_message(photograph_file(), binary=True)
        await received(tab, "uploaded")
        tab.close()
        again, other = [await connected(port, key) for key in (first["key"], "no-such")]
        return first, await received(again, "hello"), await received(other, "hello")

    first, again, other = served(started, talk)
    assert (again["pins"], again["photographs"]) == (["mine"], ["mine.png"])
    for beginning in (first, other):
        assert (beginning["pins"], beginning["photographs"]) == ([], [])
    assert len({first["key"], again["key"], other["key"]}) == 3


def test_a_copy_of_a_tab_has_a_state_of_its_own(started):
    """A browser copies the key with the tab: both go on from the pin, each with pins of its own."""

    async def talk(port):
        tab = await connected(port)
        key = (await received(tab, "hello"))["key"]
        await tab.write_message(json.dumps({"kind": "pin", "name": "shared"}))
        await received(tab, "pin")
        copy = await connected(port, key)
        await received(copy, "hello")
        pins = []
        for each, name in ((tab, "left"), (copy, "right")):
            await each.write_message(json.dumps({"kind": "pin", "name": name}))
            pins.append((await received(each, "pin"))["pins"])
        tab.close()
        return pins, (await received(await connected(port, key), "hello"))["pins"]

    pins, reloaded = served(started, talk)
    assert pins == [["shared", "left"], ["shared", "right"]]
    assert reloaded == ["shared", "left"]


@pytest.mark.slow
def test_sessions_that_are_kept_are_bounded(started):
    """The oldest is forgotten, and a tab that comes for it begins anew."""

    async def talk(port):
        tab = await connected(port)
        key = (await received(tab, "hello"))["key"]
        await tab.write_message(json.dumps({"kind": "pin", "name": "mine"}))
        await received(tab, "pin")
        tab.close()
        for _ in range(server.MOST_SESSIONS):
            other = await connected(port)
            await received(other, "hello")
            other.close()
            await asyncio.sleep(0.01)
        return (await received(await connected(port, key), "hello"))["pins"]

    assert served(started, talk) == []


BAD_MESSAGES = (
    "no JSON",
    "[" * 50_000,
    "[]",
    "7",
    '{"kind": "design"}',
    '{"kind": "design", "id": -1, "scene": {}}',
    '{"kind": "design", "id": 1, "scene": {}, "drawn": [1]}',
    '{"kind": "design", "id": 1, "scene": {"light": {"photon_rate_per_s": 1e999}}}',
    '{"kind": "design", "id": 1, "scene": {"light": NaN}}',
    '{"kind": "nothing"}',
    '{"kind": "pin", "name": ""}',
    '{"kind": "pin", "more": 1}',
    '{"kind": "design", "id": ' + "9" * 5000 + "}",
    "x" * ((2 << 20) + 1),
    b"no picture",
)


def test_bad_messages_are_answered_in_a_line_each(started):
    """The connection stays through all of them, and the next request is answered."""

    async def talk(port):
        tab, lines = await connected(port), []
        for message in BAD_MESSAGES:
            await tab.write_message(message, binary=isinstance(message, bytes))
            lines.append((await received(tab, "error"))["text"])
        await tab.write_message(asked(3))
        return lines, (await received(tab, "first"))["id"]

    lines, number = served(started, talk)
    for message, text in zip(BAD_MESSAGES, lines, strict=True):
        assert "\n" not in text, message[:24]
        assert "Traceback" not in text, message[:24]
        assert "; got" in text, message[:24]
    assert number == 3


def test_tabs_are_bounded(started):
    """One tab too many is told so and closed; a closed one makes room."""

    async def talk(port):
        tabs = [await connected(port) for _ in range(server.MOST_TABS)]
        for tab in tabs:
            await received(tab, "hello")
        refused = await connected(port)
        told = await received(refused, "closed")
        rest = await refused.read_message()
        tabs[0].close()
        await asyncio.sleep(0.2)
        again = await received(await connected(port), "hello")
        return told["text"], rest, again["kind"]

    text, rest, again = served(started, talk)
    assert text == f"at most {server.MOST_TABS} tabs at a time"
    assert rest is None
    assert again == "hello"
