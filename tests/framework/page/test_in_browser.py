"""A live page in browsers, opened from a disk: its statements on proof and run while a slider is dragged."""

from __future__ import annotations

import re
import shlex
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from in_browser import Browser
from in_chromium import Chromium
from in_firefox import firefox
from in_node import content

import dmframe as dm
from dmframe.cli.graphs import graphs_of
from dmframe.common import notebook
from dmframe.page.page import assembled, policy
from dmframe.results.run import Run
from dmframe.simulate.start import start_state

HEADLINE = "document.getElementById('headline').textContent"
PROVED = "Proved in continuous time"
DETAIL = "document.getElementById('detail').textContent"
K_C = "move-inverse.K_c"
OVERHANG = "document.documentElement.scrollWidth - document.documentElement.clientWidth"


def judges_truly(tab: Browser, page: Path) -> None:
    """Open the page, violate a condition by hand, and return."""
    tab.opened(page)
    assert tab.until(f"{HEADLINE} !== 'Loading' && {HEADLINE}") == PROVED
    assert "All 28 conditions hold" in tab.value(DETAIL)
    tab.dragged(K_C, 0.5, 0.02)
    tab.until("document.getElementById('command').textContent.includes('inverse.K_c=[0.0')")
    assert "does not apply" in tab.value(HEADLINE)
    assert "M̄ ≥ 0" in tab.value(DETAIL)
    tab.value("document.getElementById('reset').click()")
    assert tab.until(f"{HEADLINE} === '{PROVED}'")
    assert tab.said == []


BROWSERS = ("chromium", "firefox")
IN_ONE = pytest.mark.parametrize("tab", ["chromium"], indirect=True)
"""For features that need no more of a browser than JavaScript; others are tested in both browsers."""


@pytest.fixture(scope="module", params=BROWSERS)
def tab(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Browser]:
    if request.param == "chromium":
        yield request.getfixturevalue("chromium_tab")
        return
    with firefox(tmp_path_factory.mktemp("profile")) as found:
        yield found


def resealed(html: str) -> str:
    """A page that a test has changed, with the policy for its new content."""
    script, style = (re.findall(f"<{tag}>(.*?)</{tag[:6].strip()}>", html, re.DOTALL) for tag in TAGS)
    if not script or not style:
        return html
    meta = '<meta http-equiv="Content-Security-Policy" content="'
    return re.sub(re.escape(meta) + 'default-src[^"]*', lambda _: meta + policy(script[-1], style[0]), html, count=1)


TAGS = ('script type="module"', "style")


def saved(folder: Path, html: str) -> Path:
    page = folder / "page.html"
    page.write_text(resealed(html), "utf-8")
    return page


def test_a_page_from_a_disk_states_truly_what_is_proved_where_its_sliders_are(tab: Browser, tmp_path: Path) -> None:
    judges_truly(tab, saved(tmp_path, assembled(content("ur10_fast"))))


@IN_ONE
def test_a_page_whose_margins_were_wrong_would_be_noticed(tab: Browser, tmp_path: Path) -> None:
    right = assembled(content("ur10_fast"))
    wrong = right.replace("strict ? margin > 0 : margin >= 0", "true")
    assert wrong != right
    with pytest.raises(AssertionError, match="does not apply"):
        judges_truly(tab, saved(tmp_path, wrong))


WIDE = (1250, 640)  # headless Firefox cannot be wider than its assumed screen
NARROW = (390, 844)
WATCH = """(() => {
  const tops = (globalThis.tops = new Set()), slider = document.getElementById("move-inverse.K_c");
  addEventListener("pointerdown", () => tops.clear(), true);
  const look = () => { tops.add(Math.round(slider.getBoundingClientRect().top)); requestAnimationFrame(look); };
  look();
})()"""

FRAME = "new Promise((done) => requestAnimationFrame(() => done([...tops])))"
"""Position of the slider when the next picture has been drawn."""


def places_under_the_pointer(tab: Browser, page: Path, size: tuple[int, int]) -> list[float]:
    """Positions of a slider while it is dragged to where the verdict is shorter, and to where it is longer."""
    tab.sized(*size)
    tab.opened(page)
    tab.until(f"{HEADLINE} === '{PROVED}'")
    tab.value("document.documentElement.style.overflowAnchor = 'none'")  # otherwise a browser may scroll too
    tab.value(WATCH)
    tab.held(K_C, 0.5, 0.02)
    tab.until(f"{HEADLINE}.includes('does not apply')")
    tab.value(FRAME)
    tab.mouse("moves", *tab.spot(K_C, 0.6))
    tab.until(f"{HEADLINE} === 'Proved at these values in continuous time'")
    tab.let_go()
    tops: list[float] = tab.value(FRAME)
    tab.sized(None)
    return tops


@pytest.mark.parametrize("size", [WIDE, NARROW])
def test_a_slider_stays_under_the_pointer_whatever_the_verdict_states(
    tab: Browser, tmp_path: Path, size: tuple[int, int]
) -> None:
    assert len(places_under_the_pointer(tab, saved(tmp_path, assembled(content("ur10_fast"))), size)) == 1


@IN_ONE
def test_a_verdict_that_pushes_the_sliders_down_would_be_noticed(tab: Browser, tmp_path: Path) -> None:
    html = assembled(content("ur10_fast"))
    page = saved(tmp_path, html.replace("height: var(--tall);", "", 1))
    assert len(places_under_the_pointer(tab, page, NARROW)) > 1  # wider, texts may happen to take as many lines


COMMAND = "document.getElementById('command').textContent"


def test_an_address_keeps_what_was_moved(tab: Browser, tmp_path: Path) -> None:
    tab.opened(saved(tmp_path, assembled(content("arm2_joint"))), "#task.alpha_bar=1.5&clock=0.5")
    tab.until(f"{COMMAND}.includes('task.alpha_bar=3')")
    assert tab.value(HEADLINE) == "Proved at these values in continuous time"
    tab.dragged("move-task.alpha_bar", 0.54, 0.6)
    tab.until("location.hash && !location.hash.includes('alpha_bar=1.5')")
    assert "clock=0.5" in tab.value("location.hash")
    assert tab.said == []


@IN_ONE
def test_the_command_that_a_page_shows_gives_the_same_numbers(tab: Browser, tmp_path: Path) -> None:
    moved = "task.alpha_bar=1.5&inverse.Lambda=4&path.center[0]=0.2&start[1]=-0.1&clock=0.5"
    tab.opened(saved(tmp_path, assembled(content("arm2_joint"))), f"#{moved}")
    words = shlex.split(tab.until(f"{COMMAND}.includes('alpha_bar') && {COMMAND}"))
    assert words[:3] == ["dmframe", "run", "arm2_joint"]
    assert words[3::2] == ["--set"] * 6
    (graph,) = graphs_of(["arm2_joint"], words[4::2], trust=False)
    place = content("arm2_joint")["pose"]["at"]
    start = start_state(graph.diagram, graph.start)[place : place + 2]
    expected = np.array(content("arm2_joint")["state"])[place : place + 2] + np.array([0.2, -0.1])
    np.testing.assert_allclose(start, expected, atol=1e-5)
    assert (graph.clock, graph.duration) == (0.001, 20.0)
    assert graph.blocks["task"].alpha_bar == 3.0  # type: ignore[attr-defined] # a block's own parameter
    assert graph.diagram.loop.p_values[0] == pytest.approx(np.pi / 4 + 0.2, abs=1e-5)


def with_its_run(html: str) -> str:
    """The page with access to its run, which a page does not export."""
    assert html.count(END) == 1
    return html.replace(END, f"\nglobalThis.simulated = () => run;{END}")


END = "\n</script>\n</body>"


SIMULATED = "[simulated().kept, simulated().every, Array.from(simulated().log)]"
NORM = "(([...document.querySelectorAll('#first .plot:first-child .legend li')].at(-1)).textContent)"
UNIT = "document.querySelector('#first .plot:first-child .unit').textContent"
PARTS = {"m": 1.0, "mm": 1e-3, "\u00b5m": 1e-6, "rad": 1.0, "mrad": 1e-3, "\u00b5rad": 1e-6}


@cache
def run_of(name: str, overrides: tuple[str, ...]) -> Run:
    (graph,) = graphs_of([name], overrides, trust=False)
    return graph.run()


def shows_its_run(tab: Browser, page: Path, moved: str) -> None:
    """Open the page at one instant, and run the command that it shows."""
    tab.opened(page, f"#{moved}&at=1.6")
    words = shlex.split(tab.until(f"{COMMAND}.startsWith('dmframe') && {COMMAND}"))
    run = run_of(words[2], tuple(words[4::2]))
    assert any(word.startswith(moved.partition("=")[0] + "=") for word in words) == bool(moved)
    kept, every, log = tab.value(SIMULATED)
    states = np.hstack([run.recording.states[v.label] for v in run.recording.diagram.loop.variables])[::every]
    np.testing.assert_allclose(np.reshape(log[: kept * states.shape[1]], (kept, -1)), states, rtol=1e-6, atol=1e-8)
    said = re.fullmatch(r"norm(.+)", tab.until(f"/\\d/.test({NORM}) && {NORM}"))
    assert said is not None
    assert run.error is not None
    shown = float(said[1].replace("\u2212", "-")) * PARTS[tab.value(UNIT)]
    at = every * round(1.6 / run.time[every])
    assert shown == pytest.approx(run.error.norm[at], rel=0.006)  # three digits are shown
    assert tab.said == []


@pytest.mark.parametrize(("name", "moved"), [("ur10_fast", "inverse.K_c=1.2"), ("arm2_joint", "")])
def test_a_page_simulates_and_shows_what_the_command_on_it_gives(
    tab: Browser, tmp_path: Path, name: str, moved: str
) -> None:
    shows_its_run(tab, saved(tmp_path, with_its_run(assembled(content(name)))), moved)


@IN_ONE
@pytest.mark.parametrize(
    ("right", "wrong"),
    [
        ("loop.simulate({ p, ", "loop.simulate({ p: content.p, "),
        ("Math.hypot(...rows.map(", "Math.max(...rows.map("),
    ],
    ids=["the run", "what is shown of it"],
)
def test_a_page_that_shows_another_run_would_be_noticed(tab: Browser, tmp_path: Path, right: str, wrong: str) -> None:
    html = with_its_run(assembled(content("arm2_joint")))
    assert html.count(right) == 1
    with pytest.raises(AssertionError):
        shows_its_run(tab, saved(tmp_path, html.replace(right, wrong)), "task.alpha_bar=1.5")


BASELINE = """\
dmframe: 1
robot: pendulum
clock: 4 ms
duration: 1 s
blocks:
  path:     {type: sinusoid, center: [45 deg], amplitude: [30 deg], rate: [0.9 rad/s]}
  task:     {type: joint_tracking, alpha_bar: 2}
  model:    {type: regressor}
  dynamics: {type: dynamic_compensator, Gamma: 1}
  inverse:  {type: pi_inverse, Lambda: 0.01, Lambda_I: 1, w_I: 2}
  servo:    {type: pi_servo, K_P: 20, K_I: 60}
  arm:      {type: manipulator}
baseline:
  dynamics: {type: dynamic_compensator, Gamma: 5}
"""


@IN_ONE
def test_the_command_on_a_baselines_page_runs_the_baseline(tab: Browser, tmp_path: Path) -> None:
    (tmp_path / "own.yaml").write_text(BASELINE)
    page = saved(tmp_path, dm.load(tmp_path / "own.yaml").set({"task.alpha_bar": 3}).baseline().page().html)
    tab.opened(page, "#dynamics.Gamma=2&servo.K_P=1.5")
    words = shlex.split(tab.until(f"{COMMAND}.includes('Gamma') && {COMMAND}"))
    assert words[:4] == ["dmframe", "run", str(tmp_path / "own.yaml"), "--baseline"]
    assert words[4::2] == ["--set"] * 4
    (graph,) = graphs_of([words[2]], words[5::2], trust=False)
    found = graph.baseline()
    values = {parameter.label: parameter.value for parameter in found.diagram.loop.parameters}
    assert [set(values[label].ravel()) for label in ("dynamics.Gamma", "task.alpha_bar", "servo.K_P")] == [
        {10},
        {3},
        {30},
    ]
    assert graph.blocks["dynamics"].Gamma == 1  # type: ignore[attr-defined] # a block's own parameter
    assert tab.said == []


def test_a_page_runs_inside_a_notebook_which_it_cannot_reach(tab: Browser, tmp_path: Path) -> None:
    listener = "<script>addEventListener('message', (event) => (document.title = event.data))</script>"
    says = f"setInterval(() => parent.postMessage({HEADLINE}, '*'), 50)"
    inside = resealed(assembled(content("arm2_joint")).replace(END, f"\n{says}{END}"))
    tab.opened(saved(tmp_path, f"<!doctype html>{listener}{notebook.framed(inside, 'live', 800)}"))
    tab.until(f"document.title.startsWith('{PROVED}')")
    assert tab.said == []


@IN_ONE
def test_a_page_plays_by_itself_unless_its_reader_prefers_reduced_motion(tab: Browser, tmp_path: Path) -> None:
    page, now = saved(tmp_path, assembled(content("arm2_joint"))), "Number(document.getElementById('scrub').value)"
    tab.opened(page)
    tab.until(f"{HEADLINE}.startsWith('{PROVED}')")
    assert tab.value("document.getElementById('play').ariaLabel") == "Play"
    assert tab.value(now) == 0
    tab.value("document.getElementById('play').click()")
    tab.until(f"{now} > 0.05")
    assert isinstance(tab, Chromium)  # the other browser has the reader's preference before it starts
    tab.motion(True)
    tab.opened(page)
    tab.until(f"{now} > 0.05")
    tab.motion(False)
    assert tab.said == []


@IN_ONE
def test_a_page_fits_a_phone_and_its_controls_have_names(tab: Browser, tmp_path: Path) -> None:
    tab.sized(360, 740)
    tab.opened(saved(tmp_path, assembled(content("ur10_fast"))))
    tab.until(f"{HEADLINE} === '{PROVED}'")
    assert (tab.value("innerWidth"), tab.value(OVERHANG)) == (360, 0)
    controls = "[...document.querySelectorAll('input, button, select')]"
    nameless = f"{controls}.filter((e) => !e.ariaLabel && !e.labels?.length && !e.textContent)"
    assert tab.value(f"{nameless}.map((e) => e.outerHTML)") == []
    logs = "[...document.querySelectorAll('.plot button')].map((e) => e.ariaLabel)"
    assert len(set(tab.value(logs))) == tab.value(f"{logs}.length")
    moment = tab.value("document.getElementById('scrub').getAttribute('aria-valuetext')")
    assert re.fullmatch(r"\d+\.\d of 20 s", moment)
    tab.sized(None)


@pytest.mark.parametrize("name", ["ur10_fast", "arm2_joint"])
def test_a_page_is_small_and_requests_nothing(name: str) -> None:
    html = assembled(content(name))
    assert len(html.encode()) < 200_000
    assert not re.search(r"(src|href)=[\"'](?!data:)|@import|url\(|fetch\(|importScripts|https?:", html)


@IN_ONE
def test_values_in_an_address_that_a_page_cannot_set_are_reported(tab: Browser, tmp_path: Path) -> None:
    page, notice = saved(tmp_path, assembled(content("arm2_joint"))), "document.getElementById('notice').textContent"
    tab.opened(page, "#task.alpha_bar=1.5&other.K=5&clock=1e9&%ZZ&at=2")
    assert tab.until(notice) == "The address of the page sets unknown or invalid values: other.K=5, clock=1e9."
    tab.opened(page, "#texts")
    tab.until(f"{HEADLINE}.startsWith('{PROVED}')")
    assert tab.value(notice) == ""
    assert tab.said == []


def test_a_page_whose_scripts_are_not_allowed_shows_a_note(tab: Browser, tmp_path: Path) -> None:
    html = assembled(content("arm2_joint"))
    for allowed, headline, says in [
        ("'none'", "Loading", "scripts are switched off or not allowed"),
        ("'unsafe-inline'", "This browser cannot run the page", "WebAssembly"),
    ]:
        meta = f'<meta http-equiv="Content-Security-Policy" content="script-src {allowed}">'
        tab.opened(saved(tmp_path, html.replace("<head>", f"<head>{meta}")))
        assert tab.until(f"{HEADLINE} === {headline!r} && {DETAIL}.includes({says!r})")


@IN_ONE
@pytest.mark.parametrize(
    "title", ["</script><script>alert(1)</script> & \"q\" 'x' \U0001f600 @DATA@ \\1", "x" * 10_000]
)
def test_a_title_is_text_and_breaks(tab: Browser, tmp_path: Path, title: str) -> None:
    data = {**content("arm2_joint"), "title": title}
    tab.sized(320, 640)
    tab.opened(saved(tmp_path, assembled(data)))
    tab.until(f"{HEADLINE}.startsWith('{PROVED}')")
    assert tab.value("document.querySelector('h1').textContent") == title
    assert tab.value(OVERHANG) == 0
    tab.sized(None)
    assert tab.said == []


def test_a_robot_is_still_drawn_when_the_browser_takes_the_card_away(tab: Browser, tmp_path: Path) -> None:
    canvas = "document.getElementById('robot')"
    tab.opened(saved(tmp_path, assembled(content("arm2_joint"))))
    tab.until(f"{HEADLINE}.startsWith('{PROVED}')")
    lost = f"{canvas}.getContext('webgl2')?.getExtension('WEBGL_lose_context').loseContext()"
    tab.value(f"{lost}; new Promise((done) => setTimeout(done, 200))")
    pixels = f"{canvas}.getContext('2d')?.getImageData(0, 0, {canvas}.width, {canvas}.height).data"
    assert tab.until(f"{pixels}?.some((part) => part > 0)")
    tab.value(f"{canvas}.focus()")
    tab.left_arrow()
    tab.value("new Promise((done) => setTimeout(done, 100))")
    assert tab.said == []


@IN_ONE
def test_a_proved_loop_that_diverges_at_the_integrators_steps_states_that_they_are_too_long(
    tab: Browser, tmp_path: Path
) -> None:
    tab.opened(saved(tmp_path, assembled(content("pendulum"))))
    tab.until(f"{HEADLINE} === 'Proved'")
    tab.value("document.querySelectorAll('#sliders input').forEach((e) => { e.value = e.max; e.oninput(); })")
    notice = "document.getElementById('notice').textContent"
    tab.until(f"{notice}.includes('no longer finite') && {notice}.includes('continuous time, and the integrator')")
    assert tab.value(HEADLINE) == "Proved at these values"
    assert tab.said == []


@IN_ONE
def test_a_graph_of_a_path_alone_states_that_there_is_nothing_to_draw(tab: Browser, tmp_path: Path) -> None:
    path = "{type: sinusoid, center: [45 deg], amplitude: [30 deg], rate: [0.9 rad/s]}"
    text = f"dmframe: 1\nclock: 2 ms\nduration: 1 s\nblocks:\n  path: {path}\n"
    tab.opened(saved(tmp_path, dm.load(text, name="path").page().html))
    assert "nothing to draw" in tab.until("document.getElementById('first').textContent")
    assert tab.until(COMMAND).startswith("dmframe run path.yaml --set duration=1 ")
    assert tab.said == []


@IN_ONE
def test_on_a_slow_clock_the_banner_is_not_green_and_the_title_follows(tab: Browser, tmp_path: Path) -> None:
    data = {**content("ur10_fast"), "periods": {"rest": 0.0421, "moving": 0.0159, "reason": ""}}
    tab.opened(saved(tmp_path, assembled(data)), "#clock=16")
    assert tab.until(f"{HEADLINE} !== 'Loading' && {HEADLINE}") == f"{PROVED}; at 128 ms unstable near its set-point"
    assert re.search(r"V rose at \d+ of 156 samples, by at most [\d.]+ % of its decrease", tab.value(DETAIL))
    assert "sampled at 128 ms" in tab.value("document.title")
    assert "sampled at 128 ms" in tab.value("document.querySelector('h1').textContent")
    tone = "getComputedStyle(document.getElementById('headline')).color"
    slow = tab.value(tone)
    tab.value("document.getElementById('reset').click()")
    tab.until(f"{HEADLINE} === '{PROVED}'")
    assert tab.value(tone) != slow
    assert "sampled at 8 ms" in tab.value("document.title")
    assert tab.said == []


@IN_ONE
def test_nothing_but_the_pages_own_script_runs_or_connects(tab: Browser, tmp_path: Path) -> None:
    html = assembled(content("arm2_joint"))
    page = tmp_path / "page.html"
    page.write_text(html.replace("<main>", "<script>window.bad = 1</script><main>"), "utf-8")
    tab.opened(page)
    tab.until(f"{HEADLINE}.startsWith('{PROVED}')")
    assert tab.value("window.bad === undefined")
    assert any("Content Security Policy" in text for text in tab.said)
    assert tab.value("fetch('data:,x').then(() => 'connected', () => 'refused')") == "refused"


@IN_ONE
def test_a_page_shows_origin_and_licences(tab: Browser, tmp_path: Path) -> None:
    tab.opened(saved(tmp_path, assembled(content("ur10_fast"))))
    tab.until(f"{HEADLINE} === '{PROVED}'")
    assert "Licence: BSD" in tab.value("document.getElementById('from').textContent")
    assert "Redistribution" in tab.value("document.getElementById('licences').textContent")
    assert tab.said == []
