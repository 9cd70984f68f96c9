"""Who may see the page, what may be asked of it, and that it never holds up the loop. Without a browser."""

from __future__ import annotations

import io
import json
import struct
import time
import zipfile
from http.client import HTTPConnection
from pathlib import Path

import httpx
import pytest
from websockets.exceptions import ConnectionClosed, InvalidStatus
from websockets.sync.client import ClientConnection, connect

from leadline.errors import InputError
from leadline.sinks.control import TEXT_AT_MOST, Control, Wish, plain
from leadline.sinks.web_access import Access, Place, choose_token
from leadline.sinks.web_scene import beam
from leadline.wire.archive import zipped
from page_scenes import Scene, served, small_rig

TOKEN = "a-token-of-the-tests"


def quiet() -> Scene:
    """A scene that has not begun, and shall not."""
    return Scene(length_s=0.0)


def head(message: bytes) -> dict[str, object]:
    size = struct.unpack(">I", message[:4])[0]
    told = json.loads(message[4 : 4 + size])
    assert len(message) == 4 + size + sum(told["bytes"])
    return told  # type: ignore[no-any-return]


def all_of(link: ClientConnection, *, timeout_s: float, into: list[bytes] | None = None) -> None:
    """Take messages until none comes."""
    while True:
        message = link.recv(timeout=timeout_s)
        assert isinstance(message, bytes)
        if into is not None:
            into.append(message)


def status_of(port: int, path: str) -> int:
    """Of the path as it stands: httpx would tidy it up first."""
    connection = HTTPConnection("127.0.0.1", port, timeout=10)
    connection.request("GET", path)
    status = connection.getresponse().status
    connection.close()
    return status


@pytest.mark.parametrize(
    ("text", "host", "port", "loopback"),
    [
        ("127.0.0.1:80", "127.0.0.1", 80, True),
        ("localhost:0", "localhost", 0, True),
        (":9000", "127.0.0.1", 9000, True),
        ("[::1]:80", "::1", 80, True),
        ("0.0.0.0:8377", "0.0.0.0", 8377, False),
        ("192.168.2.2:8377", "192.168.2.2", 8377, False),
    ],
)
def test_a_place_is_an_address_and_a_port(text: str, host: str, port: int, loopback: bool) -> None:
    place = Place.parse(text)
    assert (place.host, place.port, place.loopback) == (host, port, loopback)


@pytest.mark.parametrize(
    "text", ["", "8377", "127.0.0.1", "127.0.0.1:x", "127.0.0.1:70000", "example.org:80", "1.2.3:5"]
)
def test_what_is_no_place_is_told_in_one_line(text: str) -> None:
    with pytest.raises(InputError, match="give ADDRESS:PORT"):
        Place.parse(text)


def test_beyond_this_computer_there_is_always_a_token() -> None:
    assert choose_token(Place(), None) is None
    first, second = (choose_token(Place("0.0.0.0", 1), None) for _ in range(2))
    assert first is not None
    assert second is not None
    assert len(first) >= 20
    assert first != second
    assert choose_token(Place(), TOKEN) == TOKEN
    for weak in ("short", "with a blank in it", 'quoted"quoted"', "ümlaut-ümlaut-ümlaut"):
        with pytest.raises(InputError, match="LEADLINE_TOKEN"):
            choose_token(Place(), weak)


@pytest.mark.parametrize(
    ("headers", "acts", "status"),
    [
        ({"host": "127.0.0.1:8377"}, False, None),
        ({"host": "localhost"}, False, None),
        ({"host": "[::1]:8377"}, False, None),
        ({"host": "192.168.2.2:8377"}, True, None),
        ({"host": "127.0.0.1:8377", "origin": "http://127.0.0.1:8377"}, True, None),
        ({"host": "evil.example:8377"}, False, 421),  # DNS rebinding
        ({"host": "127.0.0.1.evil.example"}, False, 421),
        ({"host": ""}, False, 421),
        ({}, False, 421),
        ({"host": "127.0.0.1:8377", "origin": "http://evil.example"}, True, 403),
        ({"host": "127.0.0.1:8377", "origin": "http://127.0.0.1:9999"}, True, 403),
        ({"host": "127.0.0.1:8377", "origin": "null"}, True, 403),
    ],
)
def test_other_names_and_other_sites_are_refused(headers: dict[str, str], acts: bool, status: int | None) -> None:
    refusal = Access(None).refusal(headers, "", acts=acts)
    assert (refusal and refusal[0]) == status


def test_without_the_token_nothing_is_given() -> None:
    with served(quiet(), token=TOKEN) as server:
        base, cookie = f"http://127.0.0.1:{server.port}", f"leadline_{server.port}"
        for path in ("/", "/main.js", "/alive", "/run.zip", "/nothing"):
            assert httpx.get(base + path).status_code == 401, path
            assert httpx.get(base + path, cookies={cookie: "wrong"}).status_code == 401, path
        assert httpx.get(base, params={"token": "wrong"}).status_code == 401
        for wrong in ({}, {"Cookie": f"{cookie}=wrong"}):
            with pytest.raises(InvalidStatus, match="403"):
                connect(f"ws://127.0.0.1:{server.port}/live", additional_headers=wrong)
        first = httpx.get(server.url)
        assert first.status_code == 303
        assert first.headers["location"] == "/"  # the token leaves the address bar
        assert "HttpOnly" in first.headers["set-cookie"]
        assert httpx.get(base, cookies=first.cookies).status_code == 200
        assert httpx.get(base, headers={"Authorization": f"Bearer {TOKEN}"}).status_code == 200
        with connect(f"ws://127.0.0.1:{server.port}/live", additional_headers={"Cookie": f"{cookie}={TOKEN}"}) as link:
            assert head(link.recv())["kind"] == "hello"  # type: ignore[arg-type]


def test_a_foreign_site_gets_no_websocket_and_no_name_but_ours() -> None:
    with served(quiet()) as server:
        with pytest.raises(InvalidStatus, match="403"):
            connect(f"ws://127.0.0.1:{server.port}/live", origin="http://evil.example")  # type: ignore[arg-type]
        answer = httpx.get(f"http://127.0.0.1:{server.port}/", headers={"Host": "evil.example"})
        assert answer.status_code == 421
        page = httpx.get(f"http://127.0.0.1:{server.port}/")
        assert "default-src 'self'" in page.headers["content-security-policy"]


def test_no_path_from_the_network_is_opened(tmp_path: Path) -> None:
    (tmp_path / "secret.txt").write_text("secret")
    mine = tmp_path / "solutions.csv"
    mine.write_text("t_s\n1.0\n")
    with served(quiet(), files=(mine,)) as server:
        base = f"http://127.0.0.1:{server.port}"
        for path in ("/../secret.txt", "/%2e%2e/secret.txt", "/secret.txt", f"/{tmp_path}/secret.txt", "/page.css/..",
                     "/vendor/", "/package.json", "/main.js%00", "/..%5csecret.txt", "/solutions.csv"):  # fmt: skip
            assert status_of(server.port, path) in (400, 404), path
        assert httpx.post(base + "/run.zip", content=b"x" * 100_000).status_code == 405
        answer = httpx.get(base + "/run.zip")
    assert zipfile.ZipFile(io.BytesIO(answer.content)).namelist() == ["solutions.csv"]


def test_the_archive_holds_files_as_long_as_they_were(tmp_path: Path) -> None:
    small, large = tmp_path / "a.csv", tmp_path / "b.mcap"
    small.write_bytes(b"abc")
    large.write_bytes(bytes(range(256)) * 10_000)
    pieces = zipped([small, large])
    first = next(pieces)
    with small.open("ab") as growing:
        growing.write(b"later")
    archive = zipfile.ZipFile(io.BytesIO(first + b"".join(pieces)))
    assert archive.testzip() is None
    assert archive.read("a.csv") == b"abc"
    assert archive.read("b.mcap") == large.read_bytes()


@pytest.mark.parametrize(
    "nonsense", ["", "{", "[]", "1", "null", '{"do": "format"}', '{"shown": 1e999}', "[" * 2000, "x" * 5000]
)
def test_nonsense_is_hung_up_on_and_the_next_one_served(nonsense: str) -> None:
    with served(quiet()) as server:
        with connect(f"ws://127.0.0.1:{server.port}/live") as link:
            link.send(nonsense)
            with pytest.raises(ConnectionClosed):
                all_of(link, timeout_s=5)
        with connect(f"ws://127.0.0.1:{server.port}/live") as link:
            assert head(link.recv())["kind"] == "hello"  # type: ignore[arg-type]
        assert server.alive


def test_what_is_asked_reaches_the_loop_short_and_plain() -> None:
    scene = quiet()
    with served(scene) as server, connect(f"ws://127.0.0.1:{server.port}/live") as link:
        link.send(json.dumps({"do": "record"}))
        link.send(json.dumps({"do": "mark", "text": "a\nb\x00,c  " + "x" * 500}))
        requests = []
        for _ in range(200):
            requests += scene.control.take()
            if len(requests) == 2:
                break
            time.sleep(0.01)
    assert [one.wish for one in requests] == [Wish.RECORD, Wish.MARK]
    assert requests[1].text.startswith("a b ,c x")
    assert len(requests[1].text) <= TEXT_AT_MOST


def test_asking_without_end_fills_nothing() -> None:
    control = Control()
    for _ in range(1000):
        control.ask(Wish.MARK, "again")
    assert len(control.take()) == 50
    assert control.take() == []
    assert plain("\u202eabc\r\n") == "abc"


def test_a_page_that_draws_nothing_is_sent_nothing_and_holds_nobody_up() -> None:
    scene = Scene(length_s=2.0)
    with served(scene) as server, connect(f"ws://127.0.0.1:{server.port}/live") as lazy:
        scene.thread.join()
        got: list[bytes] = []
        with pytest.raises(TimeoutError):
            all_of(lazy, timeout_s=0.5, into=got)
        assert len(got) == 2  # the greeting and one more: then it is waited for
        lazy.send(json.dumps({"shown": 2}))
        told = head(lazy.recv(timeout=5))  # type: ignore[arg-type]
        assert told["frames"] == 30  # the latest, not those between
        assert told["ended"] == ["All is said."]


def test_the_beam_is_drawn_in_both_images_where_the_rig_sees_it() -> None:
    rig = small_rig()
    lines = beam(rig)
    assert lines is not None
    assert rig.laser is not None
    for side in ("left", "right"):
        points = lines[side]
        assert len(points) == 48
        far = rig.project_one((rig.laser.origin_m + 5.0 * rig.laser.direction)[None], side)[0]
        assert points[-1] == pytest.approx(list(far), abs=0.06)


def test_a_taken_port_is_told_in_one_line() -> None:
    with (
        served(quiet()) as server,
        pytest.raises(InputError, match="give --view-at"),
        served(quiet(), place=Place(port=server.port)),
    ):
        pass
