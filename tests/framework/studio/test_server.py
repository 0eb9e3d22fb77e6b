"""The studio's server: who may use it, what it serves, and what it writes."""

from __future__ import annotations

import json
import os
import signal
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from starlette.testclient import TestClient

from dmframe.catalogue import find_graph
from dmframe.studio.server import MOST_BODY, STATIC, application

TOKEN, PORT = "a-token", 8000
PLACES = ("/", "/file", "/lists", "/events", "/static/studio.js", "/page/x")


@pytest.fixture(scope="module")
def served(tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[TestClient, Path]]:
    """A studio, whose worker takes a second to start, and its file."""
    path = tmp_path_factory.mktemp("served") / "mine.yaml"
    path.write_bytes(find_graph("pendulum").read_bytes())
    app, _ = application(path, TOKEN, PORT)
    with TestClient(app, base_url=f"http://127.0.0.1:{PORT}", follow_redirects=False) as found:
        assert found.get(f"/?token={TOKEN}").status_code == 303
        yield found, path


@pytest.fixture
def mine(served: tuple[TestClient, Path]) -> Path:
    """The file of the studio, as it was at first."""
    served[1].write_bytes(find_graph("pendulum").read_bytes())
    return served[1]


@pytest.fixture
def client(served: tuple[TestClient, Path], mine: Path) -> TestClient:
    return served[0]


def test_after_the_worker_ended_the_next_edit_starts_another(path: Path) -> None:
    app, studio = application(path, TOKEN, PORT)
    with TestClient(app, base_url=f"http://127.0.0.1:{PORT}") as client:
        client.cookies.set(f"dmframe_studio_{PORT}", TOKEN)
        process = studio.worker._process
        assert process is not None
        os.kill(process.pid, signal.SIGKILL)
        text = path.read_text()
        for k in range(3):  # the first request may meet the process that ends
            found = stages(client, text=f"{text}# {k}\n")
            if "ended" not in found:
                break
        assert found["verdict"]["outcome"] == "proved"
        assert studio.worker._process is not process


@pytest.fixture
def stranger(path: Path) -> TestClient:
    """A client without the token; the server's own tasks do not run."""
    return TestClient(application(path, TOKEN, PORT)[0], base_url=f"http://127.0.0.1:{PORT}", follow_redirects=False)


def stages(client: TestClient, **wanted: str) -> dict[str, Any]:
    lines = client.post("/examine", json=wanted).text.splitlines()
    return {stage["stage"]: stage for stage in map(json.loads, lines)}


@pytest.mark.parametrize("place", PLACES)
def test_without_the_token_there_is_no_access(stranger: TestClient, place: str) -> None:
    for answer in (stranger.get(place), stranger.get(f"{place}?token=another"), stranger.get(f"{place}?token=ä")):
        assert answer.status_code == 403
        assert "token" in answer.text
        assert "set-cookie" not in answer.headers


@pytest.mark.parametrize("place", ["/examine", "/save"])
def test_without_the_token_no_text_is_examined_and_no_file_is_written(
    stranger: TestClient, place: str, path: Path
) -> None:
    before = path.read_bytes()
    assert stranger.post(place, json={"text": "x", "version": ""}).status_code == 403
    assert path.read_bytes() == before


def test_another_name_of_this_computer_has_no_access(stranger: TestClient) -> None:
    """A page of the network whose name resolves to 127.0.0.1."""
    stranger.cookies.set(f"dmframe_studio_{PORT}", TOKEN)
    assert stranger.get("/file").status_code == 200
    for host in ("evil.example:8000", "127.0.0.1:8001", "127.0.0.1", ""):
        assert stranger.get("/file", headers={"host": host}).status_code == 403
    for origin in ("http://evil.example", "null", f"http://127.0.0.1:{PORT + 1}"):
        assert stranger.post("/save", json={}, headers={"origin": origin}).status_code == 403
    assert stranger.post("/save", json={}, headers={"origin": f"http://127.0.0.1:{PORT}"}).status_code == 400


def test_the_cookie_is_kept_from_scripts_and_other_sites(stranger: TestClient) -> None:
    answer = stranger.get(f"/?token={TOKEN}")
    assert (answer.status_code, answer.headers["location"]) == (303, "/")
    assert {"HttpOnly", "SameSite=strict"} <= set(answer.headers["set-cookie"].split("; "))


@pytest.mark.parametrize(
    "place",
    ["/static/../server.py", "/static/..%2fserver.py", "/static/%2fetc%2fpasswd", "/page/../file", "/mine.yaml"],
)
def test_no_other_file_is_served(stranger: TestClient, place: str) -> None:
    stranger.cookies.set(f"dmframe_studio_{PORT}", TOKEN)
    answer = stranger.get(place)
    assert answer.status_code in (404, 200)
    assert "import" not in answer.text
    assert "root:" not in answer.text
    if answer.status_code == 200:  # a client may resolve the dots itself
        assert answer.json()["name"] == "mine.yaml"


@pytest.mark.parametrize("name", STATIC)
def test_its_own_scripts_are_served(stranger: TestClient, name: str) -> None:
    stranger.cookies.set(f"dmframe_studio_{PORT}", TOKEN)
    assert stranger.get(f"/static/{name}").status_code == 200


def test_a_text_is_examined_and_its_page_cannot_read_the_studio(client: TestClient, mine: Path) -> None:
    found = stages(client, text=mine.read_text())
    assert found["verdict"]["outcome"] == "proved"
    assert "html" not in found["page"]
    page = client.get(f"/page/{found['page']['page']}")
    assert page.headers["content-security-policy"] == "sandbox allow-scripts; frame-ancestors 'self'"
    assert "<!doctype html>" in page.text
    assert "script-src 'self';" in client.get("/").headers["content-security-policy"]


def test_a_faulty_text_has_its_faults_and_no_verdict(client: TestClient, mine: Path) -> None:
    found = stages(client, text=mine.read_text().replace("K_c: 1,", "K_c: -1,"))
    assert list(found) == ["faults", "done"]


def test_results_are_remembered_until_a_file_next_to_the_graph_changes(client: TestClient, mine: Path) -> None:
    own = mine.with_name("own.py")
    own.write_text("from dmframe_blocks.dynamic_compensator import DynamicCompensator as Own\n")
    text = mine.read_text().replace("type: dynamic_compensator", "type: own.py:Own")
    found = [stages(client, text=text) for _ in range(2)]
    assert found[0] == found[1]  # the times of the proof included
    own.write_text("from dmframe_blocks.dynamic_compensator import DynamicCompensator as Other\n")
    assert "unknown class" in stages(client, text=text)["faults"]["faults"][0]["text"]


def test_a_packaged_graph_can_be_compared_with(client: TestClient) -> None:
    found = stages(client, graph="pendulum")
    assert found["text"]["text"] == find_graph("pendulum").read_text("utf-8")
    assert found["verdict"]["outcome"] == "proved"
    lists = client.get("/lists").json()
    assert {"pendulum", "ur10_fast"} <= set(lists["graphs"])
    assert "block_pid_inverse" in lists["schema"]["$defs"]
    for name in ("../mine", "/etc/passwd", "none"):
        assert "no such packaged graph" in stages(client, graph=name)["ended"]["reason"]


def test_the_file_is_written_when_it_is_saved_and_only_the_version_that_was_opened(
    client: TestClient, mine: Path
) -> None:
    opened = client.get("/file").json()
    assert opened["text"] == mine.read_text()
    stages(client, text="dmframe: 1\n")
    assert opened["text"] == mine.read_text()
    saved = client.post("/save", json={"text": opened["text"] + "# more\n", "version": opened["version"]})
    assert mine.read_text() == opened["text"] + "# more\n"
    assert saved.json()["version"] == client.get("/file").json()["version"]
    late = client.post("/save", json={"text": "late", "version": opened["version"]})  # a second tab
    assert late.status_code == 409
    assert late.json()["now"]["text"] == mine.read_text() == opened["text"] + "# more\n"
    mine.unlink()
    assert client.get("/file").json()["problem"].startswith("the file does not exist")


def test_what_is_no_request_is_refused(stranger: TestClient, path: Path) -> None:
    stranger.cookies.set(f"dmframe_studio_{PORT}", TOKEN)
    before = path.read_bytes()
    for content in (b"", b"{", b"[]", b"3", b"\xff", b"[" * 100_000, b'{"text": 3, "version": ""}', b'{"text": "x"}'):
        assert stranger.post("/save", content=content).status_code == 400
        assert stranger.post("/examine", content=content.replace(b'"x"', b"1")).status_code == 400
    assert stranger.post("/save", content=b" " * (MOST_BODY + 1)).status_code == 413
    lone = json.dumps({"text": "\ud800", "version": stranger.get("/file").json()["version"]})
    assert stranger.post("/save", content=lone).status_code == 422
    assert path.read_bytes() == before
