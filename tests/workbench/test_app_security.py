"""The workbench lets in this machine, by its own name, from its own page, with the token, and nothing outside the folder."""

from __future__ import annotations

import json
import os
import re
import socket
from importlib.resources import files
from pathlib import Path

import pytest
from app_cases import require_workbench, served

require_workbench()

from structid.core.errors import InputError  # noqa: E402
from structid.workbench.folder import OutsideError, open_study_folder, upload_name  # noqa: E402
from structid.workbench.security import MOST_REQUEST, MOST_UPLOAD, Access  # noqa: E402

EVIL = "<img src=x onerror=alert(1)>"


@pytest.fixture(scope="module")
def bench(tmp_path_factory):
    folder = tmp_path_factory.mktemp("folder")
    (folder / "study.toml").write_text(f'title = "{EVIL}"\n[structure]\n', encoding="utf-8")
    (folder / "notes.py").write_text("secret", encoding="utf-8")
    (folder.parent / "outside.toml").write_text('title = "outside"\n[structure]\n', encoding="utf-8")
    (folder / "link.toml").symlink_to(folder.parent / "outside.toml")
    (folder / "results").mkdir()
    (folder / "results" / "estimate.json").write_text("{}", encoding="utf-8")
    (folder / "results" / "report.html").write_text("<h1>report</h1>", encoding="utf-8")
    with served(folder) as found:
        found_folder = folder
        yield found, found_folder


def test_with_token_it_answers(bench):
    status, headers, body = bench[0].ask("GET", "/")
    assert status == 200
    assert b"structid" in body
    policy = headers["content-security-policy"]
    assert "default-src 'none'" in policy
    assert "script-src 'self';" in policy
    assert "frame-ancestors 'none'" in policy
    assert headers["x-content-type-options"] == "nosniff"
    assert headers["referrer-policy"] == "no-referrer"


@pytest.mark.parametrize("token", ["", "wrong", "static", "api", "%C3%A9"])
@pytest.mark.parametrize("path", ["/", "/api/folder", "/static/main.js", "/api/study?study=study.toml"])
def test_without_the_token_nothing_is_told(bench, token, path):
    status, _, body = bench[0].ask("GET", path, token=token)
    assert status == 403
    assert b"token" in body


@pytest.mark.parametrize(
    "host", ["example.org", "evil.example:{port}", "127.0.0.1", "127.0.0.1:1", "127.0.0.1.evil.org:{port}"]
)
def test_another_host_is_refused(bench, host):
    """As after a name of a foreign page was made to lead to this machine."""
    status, _, body = bench[0].ask("GET", "/api/folder", headers={"Host": host.format(port=bench[0].port)})
    assert status == 403
    assert b"study.toml" not in body


@pytest.mark.parametrize(
    "headers",
    [
        {"Origin": "https://evil.example"},
        {"Origin": "null"},
        {"Origin": "http://127.0.0.1:1"},
        {"Sec-Fetch-Site": "cross-site"},
        {"Sec-Fetch-Site": "same-site"},
    ],
)
@pytest.mark.parametrize("method", ["GET", "POST"])
def test_another_origin_is_refused(bench, headers, method):
    status, _, _ = bench[0].ask(method, "/api/folder", b"{}" if method == "POST" else None, headers)
    assert status == 403


def test_the_own_origin_is_let_in(bench):
    own = {"Origin": f"http://127.0.0.1:{bench[0].port}", "Sec-Fetch-Site": "same-origin"}
    assert bench[0].ask("GET", "/api/folder", headers=own)[0] == 200


@pytest.mark.parametrize("method", ["DELETE", "OPTIONS", "PATCH", "TRACE"])
def test_other_methods_are_refused(bench, method):
    assert bench[0].ask(method, "/api/folder")[0] == 405


OUTSIDE = [
    "../outside.toml",
    "/etc/hostname",
    "a/../../outside.toml",
    "link.toml",
    "..\\outside.toml",
    ".",
    "",
    "c:/x",
    "a\0b",
]


@pytest.mark.parametrize("name", OUTSIDE)
def test_no_path_leads_outside(bench, name):
    status, found = bench[0].get("study", study=name)
    assert status == 403
    assert set(found) == {"error"}
    assert "title" not in found["error"]
    with pytest.raises(OutsideError, match="inside the open folder"):
        open_study_folder(bench[1]).inside(name)


@pytest.mark.parametrize("name", ["../outside.toml", "/tmp/x.toml", "link.toml"])
def test_nothing_is_written_outside(bench, name):
    before = (bench[1].parent / "outside.toml").read_bytes()
    for path, body in (
        ("study", {"study": name, "text": "a = 1", "digest": ""}),
        ("edit", {"study": name, "digest": "", "edits": []}),
        ("init", {"template": "beam", "path": name, "numbers": {}}),
        ("init", {"template": "mesh", "path": name, "numbers": {"path": "a.msh"}}),
        ("runs", {"study": name, "results": "results"}),
        ("runs", {"study": "study.toml", "results": name.removesuffix(".toml")}),
    ):
        status, _ = bench[0].post(path, body)
        if name != "link.toml" or body.get("results") is None:
            assert status == 403, path
    assert (bench[1].parent / "outside.toml").read_bytes() == before


@pytest.mark.parametrize("name", ["../outside.msh", "/tmp/outside.msh", "a/../../outside.msh"])
def test_no_mesh_or_file_of_modes_outside_is_read(bench, name):
    (bench[1].parent / "outside.msh").write_text("secret", encoding="utf-8")
    for path, body in (
        ("mesh", {"path": name, "length_unit": "m"}),
        ("init", {"template": "mesh", "path": "new.toml", "numbers": {"path": name}}),
        ("merge", {"records": [name, name], "options": {}, "out": "merged", "band": None}),
        ("beside", {"study": "study.toml", "number": 0, "measured": name, "at": ""}),
        ("beside", {"study": "study.toml", "number": 0, "measured": "study.toml", "at": name}),
    ):
        status, found = bench[0].post(path, body)
        assert status == 422, path
        assert "is no path inside the open folder" in found["error"], path
        assert "secret" not in found["error"]
    assert not (bench[1] / "new.toml").exists()


@pytest.mark.parametrize(
    "path",
    [
        "/api/download?path=notes.py",
        "/api/download?path=../outside.toml",
        "/api/export?results=..",
        "/static/..%2Fserver.py",
        "/static/../server.py",
        "/static/%2e%2e/server.py",
        "/static/steps/..%2F..%2Fserver.py",
        "/static/steps/../../server.py",
    ],
)
def test_only_results_and_studies_are_given_out(bench, path):
    status, _, body = bench[0].ask("GET", path)
    assert status in (400, 403, 404, 422)
    assert b"secret" not in body
    assert b"import" not in body


def test_a_page_of_results_runs_apart_and_by_its_own_key(bench):
    status, found = bench[0].get("results", results="results")
    assert status == 200
    assert bench[0].token not in found["report"]
    assert found["report"].startswith("/view/")
    key = found["report"].split("/")[2]
    status, headers, body = bench[0].ask("GET", f"/{key}/results/report.html", token="view")
    assert (status, body) == (200, b"<h1>report</h1>")
    assert headers["content-security-policy"].startswith("sandbox allow-scripts; default-src 'none'")
    for other in ("/results/estimate.json", "/study.toml", "/../outside.toml"):
        assert bench[0].ask("GET", f"/{key}{other}", token="view")[0] in (403, 404)
    assert bench[0].ask("GET", f"/{'0' * 40}/results/report.html", token="view")[0] == 403


def test_too_much_at_once_is_refused(bench):
    long = {"Content-Length": str(MOST_REQUEST + 1), "Content-Type": "application/json"}
    assert bench[0].ask("POST", "/api/study", b"{", long)[0] == 413
    long = {"Content-Length": str(MOST_UPLOAD + 1)}
    assert bench[0].ask("PUT", "/api/file?name=long.npy", b"x", long)[0] == 413
    assert bench[0].ask("PUT", "/api/file?name=long.npy", b"x", {"Content-Length": "many"})[0] in (400, 413)
    assert not (bench[1] / "long.npy").exists()


def test_a_body_longer_than_it_may_be_is_cut(bench):
    """Sent in chunks, which say no length before."""
    body = json.dumps({"study": "long.toml", "text": "# " + "x" * 4_000_000, "digest": ""}).encode()
    pieces = [body[k : k + 500_000] for k in range(0, len(body), 500_000)]
    connection = socket.create_connection(("127.0.0.1", bench[0].port), timeout=300)
    head = f"POST /{bench[0].token}/api/study HTTP/1.1\r\nHost: 127.0.0.1:{bench[0].port}\r\nTransfer-Encoding: chunked\r\n\r\n"
    connection.sendall(head.encode())
    try:
        for piece in pieces:
            connection.sendall(f"{len(piece):x}\r\n".encode() + piece + b"\r\n")
        connection.sendall(b"0\r\n\r\n")
        answer = connection.recv(200)
    except OSError:
        answer = b""
    finally:
        connection.close()
    assert b" 200 " not in answer
    assert not (bench[1] / "long.toml").exists()
    assert bench[0].get("folder")[0] == 200


def test_an_upload_that_breaks_off_leaves_nothing(bench):
    connection = socket.create_connection(("127.0.0.1", bench[0].port), timeout=300)
    address = f"PUT /{bench[0].token}/api/file?name=half.npy HTTP/1.1"
    head = f"{address}\r\nHost: 127.0.0.1:{bench[0].port}\r\nContent-Length: 1000\r\n\r\n"
    connection.sendall(head.encode() + b"x" * 10)
    connection.close()
    assert bench[0].get("folder")[0] == 200
    assert not list(bench[1].glob("*half*"))


@pytest.mark.parametrize("name", ["../../evil.toml", "a/b/c.npz", "..", "x.exe", "", ".npz", "\u202enpz.exe", "x.html"])
def test_names_of_dropped_files_are_harmless(name):
    try:
        clean = upload_name(name)
    except InputError:
        return
    assert "/" not in clean
    assert ".." not in clean
    assert clean.endswith((".toml", ".npz"))


def test_the_suffix_of_a_long_name_stays():
    assert upload_name("a" * 300 + ".npz") == "a" * 116 + ".npz"
    assert upload_name("a" * 115 + ". b.NPZ") == "a" * 115 + ".NPZ"


def test_another_folder_is_opened_behind_a_token_of_its_own(bench):
    """Neither reaches what the other holds; only a folder that was asked for is opened."""
    other = bench[1].parent / "other"
    (other / "results").mkdir(parents=True)
    (other / "only.toml").write_text('title = "only here"\n[structure]\n', encoding="utf-8")
    (other / "results" / "report.html").write_text("<h1>other</h1>", encoding="utf-8")
    (other / "results" / "estimate.json").write_text("{}", encoding="utf-8")
    status, found = bench[0].post("open", {"folder": f" '{other}' "})
    assert status == 200
    token = found["address"].strip("/")
    assert len(token) >= 32
    assert token != bench[0].token

    def asked(token: str, path: str) -> tuple[int, bytes]:
        return bench[0].ask("GET", path, token=token)[::2]

    assert b"only here" in asked(token, "/api/study?study=only.toml")[1]
    assert asked(bench[0].token, "/api/study?study=only.toml")[0] == 422
    assert asked(bench[0].token, "/api/study?study=../other/only.toml")[0] == 403
    assert asked(token, "/api/study?study=study.toml")[0] == 422
    assert asked(token, f"/api/study?study=../{bench[1].name}/study.toml")[0] == 403
    assert bench[0].get("folder")[1]["folder"] == str(bench[1])
    pages = {
        one: json.loads(asked(one, "/api/results?results=results")[1])["report"] for one in (token, bench[0].token)
    }
    keys = {one: page.split("/")[2] for one, page in pages.items()}
    assert len(set(keys.values())) == 2  # of one name, and each is that of its folder
    for one, key in keys.items():
        body = asked("view", f"/{key}/results/report.html")[1]
        assert (body == b"<h1>other</h1>") == (one == token)
    assert bench[0].post("open", {"folder": str(other / ".." / "other")})[1]["address"] == found["address"]
    assert asked(token[:-1] + ("a" if token[-1] != "a" else "b"), "/api/folder")[0] == 403


@pytest.mark.parametrize(
    ("given", "words"),
    [
        ("", "nothing: is no whole path"),
        ("folder", "is no whole path"),
        ("../other", "is no whole path"),
        ("/nowhere/at/all", "is no folder; / is there"),
        ("{root}/study.toml", "is a file and no folder"),
        ("/tmp/a\0b", "is no whole path"),
        ("~nobody-of-this-name/x", "no such user"),
        (7, "is no whole path"),
        ("file:///etc", "is no whole path"),
        ("/" + "x" * 5000, "cannot be opened"),
    ],
)
def test_what_is_no_folder_is_not_opened(bench, given, words):
    status, found = bench[0].post("open", {"folder": str(given).replace("{root}", str(bench[1])) if given != 7 else 7})
    assert status == 422
    assert words in found["error"]


def test_a_folder_is_opened_for_the_own_page_alone(bench):
    body = json.dumps({"folder": "/tmp"}).encode()
    for headers in ({"Origin": "https://evil.example"}, {"Host": "evil.example"}, {"Sec-Fetch-Site": "cross-site"}):
        assert bench[0].ask("POST", "/api/open", body, headers)[0] == 403
    assert bench[0].ask("POST", "/api/open", body, token="wrong")[0] == 403
    assert bench[0].ask("GET", "/api/open?folder=/tmp")[0] == 405


def test_of_a_folder_of_very_many_files_some_are_looked_at_and_that_is_told(tmp_path, monkeypatch):
    for k in range(12):
        (tmp_path / f"{k:02}.toml").write_text('title = "one"\n[structure]\n', encoding="utf-8")
    place = open_study_folder(tmp_path)
    assert (len(place.listing()["studies"]), place.listing()["most"]) == (12, None)
    monkeypatch.setattr("structid.workbench.folder._MOST", 5)
    assert (len(place.listing()["studies"]), place.listing()["most"]) == (5, 5)
    assert sorted(place.stamps()) == [f"{k:02}.toml" for k in range(5)]


def test_a_study_whose_suffix_is_in_capitals_is_listed_and_watched(tmp_path):
    (tmp_path / "FRAME.TOML").write_text('title = "one"\n[structure]\n', encoding="utf-8")
    place = open_study_folder(tmp_path)
    assert [one["path"] for one in place.listing()["studies"]] == list(place.stamps()) == ["FRAME.TOML"]


def test_titles_and_names_are_told_as_texts(bench):
    """JSON holds them; the page makes texts of them (see the test in the browser) and has no inner HTML."""
    status, headers, body = bench[0].ask("GET", "/api/folder")
    assert status == 200
    assert headers["content-type"] == "application/json"
    assert EVIL in [one["title"] for one in json.loads(body)["studies"]]
    static = Path(str(files("structid.workbench") / "static"))
    for path in (path for path in static.rglob("*") if path.is_file()):
        text = path.read_text(encoding="utf-8")
        for word in ("innerHTML", "outerHTML", "insertAdjacentHTML", "document.write", "eval(", "http://", "https://"):
            assert word not in text, (path.name, word)


def test_tokens_differ_and_are_long():
    tokens = {Access(1).token for _ in range(50)}
    assert len(tokens) == 50
    assert min(map(len, tokens)) >= 32


def test_it_listens_on_this_machine_only(bench):
    """No address but the loopback one has the port."""
    if not hasattr(os, "getuid"):
        pytest.skip("reads the table of Linux")
    with Path("/proc/net/tcp").open(encoding="ascii") as stream:
        rows = [line.split() for line in stream][1:]
    listening = [row[1] for row in rows if row[3] == "0A" and int(row[1].split(":")[1], 16) == bench[0].port]
    assert listening == [f"0100007F:{bench[0].port:04X}"]


def test_modules_of_the_page_import_modules_that_are_served():
    static = Path(str(files("structid.workbench") / "static"))
    missing = [
        (path.name, name)
        for path in static.rglob("*.js")
        for name in re.findall(r"""(?:from|import)\s*\(?\s*["'](\.[^"']+)["']""", path.read_text(encoding="utf-8"))
        if not (path.parent / name).is_file()
    ]
    assert missing == []
