// The studio: an edit of the text is examined by the server, whose stages set verdict, diagram and live page.
import * as cm from "./editor.min.js";
import { completions, described } from "./complete.js";

const find = (id) => document.getElementById(id);
const PAUSE = 60; // after the last key, before the text is examined [ms]
const fetched = { file: null, version: "", schema: null };
let request = null; // of the present text
let base = null; // text of the live page that is shown
let quick = ""; // what the live page found by itself at the new values, until the proof ends
let timer = 0, clock = 0, view = null, saved = "", conflict = null, alive = true;

function make(name, given = {}, ...inner) {
  const made = document.createElement(name);
  for (const [key, value] of Object.entries(given)) key.startsWith("on") ? (made[key] = value) : made.setAttribute(key, value);
  made.append(...inner);
  return made;
}

// A text with indices as subscripts, as pieces for `make`: q_d as q and subscript d. Names such as dynamics.a_d_hat stay.
function typeset(text) {
  return text.split(/((?<![\p{L}\d_.])\p{L}[\u0300-\u036f]*_(?:\p{L}+\d*|\d+|⋆))(?![\p{L}_])/u).map((piece, k) => {
    if (k % 2 === 0) return piece;
    const [base, index] = piece.split("_");
    return make("span", {}, base, make("sub", {}, index));
  });
}

async function answered(path, body) {
  const answer = await fetch(path, body === undefined ? {} : { method: "POST", body: JSON.stringify(body), headers: { "Content-Type": "application/json" } });
  if (!answer.ok && ![409, 422].includes(answer.status)) throw new Error((await answer.text()).trim());
  return [answer.status, await answer.json()];
}

// ---- text

const text = () => view.state.sliceDoc();
const setNamed = cm.StateEffect.define();
const named = cm.StateField.define({ // lines of the blocks that the verdict names
  create: () => cm.Decoration.none,
  update(marks, change) {
    for (const effect of change.effects) if (effect.is(setNamed)) return effect.value;
    return marks.map(change.changes);
  },
  provide: (field) => cm.EditorView.decorations.from(field),
});
const outside = cm.Annotation.define(); // a change that is not the user's

function editor() {
  const { schema } = fetched;
  const help = cm.hoverTooltip((_, position) => {
    const found = described(schema, view.state, position);
    return found && { pos: found.from, end: found.to, above: true, create: () => ({ dom: make("div", { class: "about" }, found.text) }) };
  });
  return new cm.EditorView({
    parent: find("text"),
    state: cm.EditorState.create({
      doc: fetched.file.text,
      extensions: [
        cm.lineNumbers(), cm.history(), cm.drawSelection(), cm.highlightActiveLine(), cm.bracketMatching(), cm.closeBrackets(), cm.indentUnit.of("  "),
        cm.yaml(), cm.syntaxHighlighting(cm.defaultHighlightStyle), cm.lintGutter(), named, help, cm.EditorView.lineWrapping,
        cm.autocompletion({ override: [completions(schema)] }),
        cm.keymap.of([{ key: "Mod-s", run: () => (save(), true) }, cm.indentWithTab, ...cm.closeBracketsKeymap, ...cm.completionKeymap, ...cm.historyKeymap, ...cm.defaultKeymap]),
        cm.EditorView.contentAttributes.of({ "aria-label": "Text of the graph", spellcheck: "false" }),
        cm.EditorState.readOnly.of(Boolean(fetched.file.problem)),
        cm.EditorView.updateListener.of((update) => { if (update.docChanged) edited(); }),
      ],
    }),
  });
}

function replaced(content) {
  view.dispatch({ changes: { from: 0, to: view.state.doc.length, insert: content }, annotations: outside.of(true) });
}

function edited() {
  quick = "";
  frames.mine.edit = -1; // answers of the page to earlier edits no longer count
  waits("Checking");
  showState();
  clearTimeout(timer);
  timer = setTimeout(examine, PAUSE);
}

function showState(note = "") {
  const changed = text() !== saved;
  find("state").textContent = note || (!alive ? "no connection to the studio" : changed ? "not saved" : fetched.version ? "saved" : "the file does not exist");
  find("state").className = changed ? "unsaved" : "";
  find("save").disabled = !changed && Boolean(fetched.version);
  document.title = `${changed ? "• " : ""}${fetched.file.name} - dmframe studio`;
}

// ---- examination

async function* stages(body, signal) {
  const answer = await fetch("/examine", { method: "POST", body: JSON.stringify(body), signal, headers: { "Content-Type": "application/json" } });
  if (!answer.ok) throw new Error((await answer.text()).trim());
  const reader = answer.body.pipeThrough(new TextDecoderStream()).getReader();
  for (let rest = ""; ;) {
    const { value, done } = await reader.read();
    const lines = (rest + (value ?? "")).split("\n");
    rest = lines.pop();
    for (const line of lines) yield JSON.parse(line);
    if (done) return;
  }
}

async function examine() {
  request?.abort();
  frames.mine.drop();
  const own = (request = new AbortController()), content = text();
  waits("Checking");
  try {
    for await (const stage of stages(base === null ? { text: content } : { text: content, base }, own.signal)) {
      if (own !== request) return;
      show(stage, content);
    }
  } catch (error) {
    if (own === request && error.name !== "AbortError") fails("No result", `${error.message}; is the studio still running?`);
  }
}

function show(stage, content) {
  if (stage.stage === "faults") return showFaults(stage.faults);
  if (stage.stage === "numbers") frames.mine.set(stage.p);
  if (stage.stage === "diagram") showDiagram(stage);
  if (stage.stage === "verdict") showVerdict(stage);
  if (stage.stage === "page" && stage.page) { frames.mine.load(stage.page, () => (base = content)); }
  if (stage.stage === "page" && stage.reason) { frames.mine.empty(`There is no live page: ${stage.reason}`); base = null; }
  if (stage.stage === "ended") fails("No result", stage.reason);
}

// A text that is not examined yet has no verdict: the old one is not shown as that of the new text.
function waits(what) {
  clearInterval(clock);
  const began = performance.now();
  const count = () => { find("detail").textContent = `${((performance.now() - began) / 1000).toFixed(0)} s${quick}`; };
  find("verdict").className = "waiting";
  find("headline").textContent = `${what} ...`;
  find("detail").textContent = "";
  clock = setInterval(count, 250);
  find("faults").hidden = find("more").hidden = true;
  frames.mine.holder.classList.add("stale");
}

function settled(state, headline, detail) {
  clearInterval(clock);
  find("verdict").className = state;
  find("headline").replaceChildren(...typeset(headline));
  find("detail").replaceChildren(...typeset(detail));
}

function fails(headline, detail) {
  settled("failed", headline, detail);
}

function showFaults(faults) {
  settled("failed", faults.length > 1 ? `${faults.length} faults` : "A fault", "The diagram and the page below are those of an earlier text.");
  find("faults").replaceChildren(...faults.map((fault) => make("li", {},
    ...(fault.line ? [make("button", { type: "button", onclick: () => goto(fault) }, `line ${fault.line}`), ": "] : []), fault.text)));
  find("faults").hidden = false;
  find("drawing").classList.add("stale");
  mark([...new Set(faults.map(({ block }) => block).filter(Boolean))]);
  const { doc } = view.state;
  view.dispatch(cm.setDiagnostics(view.state, faults.filter(({ line }) => line > 0 && line <= doc.lines).map(({ line, column, text: message }) => {
    const at = doc.line(line), from = Math.min(at.to, at.from + [...at.text].slice(0, column - 1).join("").length), word = /^[^\s,}\]]*/.exec(at.text.slice(from - at.from))[0];
    return { from, to: Math.min(at.to, from + Math.max(1, word.length)), severity: "error", message };
  })));
}

function goto({ line, column }) {
  const at = view.state.doc.line(Math.min(line, view.state.doc.lines));
  view.dispatch({ selection: { anchor: Math.min(at.to, at.from + column - 1) }, scrollIntoView: true });
  view.focus();
}

function showDiagram({ svg, about, title }) {
  view.dispatch(cm.setDiagnostics(view.state, []));
  waits("Proving");
  const drawn = new DOMParser().parseFromString(svg, "image/svg+xml").documentElement;
  find("diagram").replaceChildren(document.adoptNode(drawn));
  find("drawing").classList.remove("stale");
  find("about").textContent = `Diagram: ${about}`;
  find("about").title = title;
  mark([]);
}

// Marks blocks in the diagram and in the text.
function mark(blocks) {
  for (const group of find("diagram").querySelectorAll(".block")) group.classList.toggle("named", blocks.includes(group.dataset.name));
  const { doc } = view.state, marks = [];
  for (let number = 1; number <= doc.lines; number++) {
    const line = doc.line(number);
    if (blocks.some((name) => new RegExp(`^\\s+${name}:`).test(line.text))) marks.push(cm.Decoration.line({ class: "cm-named" }).range(line.from));
  }
  view.dispatch({ effects: setNamed.of(cm.Decoration.set(marks)) });
}

const capital = (words) => words.charAt(0).toUpperCase() + words.slice(1);

function showVerdict({ outcome, headline, restriction, reason, blocks, conditions, conclusions, text: whole }) {
  const proved = outcome === "proved", follows = conclusions.length ? ` It follows that ${conclusions.join(" and that ")}.` : "";
  settled(proved ? "proved" : "failed", capital(headline), `${restriction ? `${restriction}. ` : ""}${capital(reason)}.${follows}${blocks.length ? ` Block${blocks.length > 1 ? "s" : ""}: ${blocks.join(", ")}.` : ""}`);
  find("conditions").replaceChildren(...conditions.map(({ name, margin, holds, how }) => make("tr", { class: holds ? "yes" : "no" },
    ...[name, margin ?? "", holds ? (how === "sampled" ? "sampled, not proved" : "holds") : "fails"].map((cell) => make("td", {}, ...typeset(cell))))));
  find("whole").textContent = whole;
  find("more").hidden = false;
  mark(blocks);
}

// ---- live pages

// A page is loaded behind the old one and shown as soon as it has simulated, so that an edit does not blank it.
class Frames {
  static edits = 0;
  constructor(holder) { this.holder = holder; this.shown = this.next = null; this.edit = -1; }

  load(page, done = () => {}) {
    this.drop();
    const made = make("iframe", { sandbox: "allow-scripts", class: "next", title: "Live page", src: `/page/${page}` });
    this.next = made;
    made.ready = () => {
      if (this.next !== made) return;
      for (const other of [...this.holder.children]) if (other !== made) other.remove();
      made.className = "";
      this.shown = made;
      this.next = null;
      this.holder.classList.remove("stale");
      done();
    };
    made.onload = () => setTimeout(made.ready, 1500); // a browser in which the page cannot run
    this.holder.append(made);
  }

  // Forgets a page of an earlier text that is still loading.
  drop() {
    this.next?.remove();
    this.next = null;
  }

  set(p) {
    this.edit = ++Frames.edits;
    this.shown?.contentWindow.postMessage({ p, edit: this.edit }, "*");
    this.holder.classList.remove("stale");
  }

  empty(why) {
    this.shown = this.next = null;
    this.holder.classList.remove("stale");
    this.holder.replaceChildren(make("p", { class: "quiet" }, why));
  }
}

const frames = { mine: new Frames(find("mine").querySelector(".frames")), theirs: new Frames(find("theirs").querySelector(".frames")) };
addEventListener("message", ({ source, data }) => {
  if (typeof data?.headline !== "string") return;
  if (frames.mine.shown?.contentWindow === source && data.edit === frames.mine.edit) quick = `; the page, at these values: ${data.headline}`;
  for (const { next } of Object.values(frames)) if (next?.contentWindow === source) next.ready();
});

// ---- comparison

let theirs = null; // text of the other side
async function compare() {
  const wanted = find("other").value, side = find("theirs"), own = (compare.own = Symbol());
  side.hidden = !wanted;
  find("mine").querySelector(".side-name").hidden = !wanted;
  theirs = null;
  if (!wanted) return;
  const names = { pin: "The text as it was when you chose it", file: "The file on disk" };
  side.querySelector(".side-name").textContent = names[wanted] ?? wanted;
  const verdict = side.querySelector(".side-verdict"), says = (state, words) => { verdict.className = `side-verdict ${state}`; verdict.textContent = words; };
  says("", "Proving ...");
  frames.theirs.empty("");
  try {
    const content = wanted === "pin" ? text() : wanted === "file" ? (await answered("/file"))[1].text : null;
    theirs = content;
    for await (const stage of stages(content === null ? { graph: wanted } : { text: content })) {
      if (compare.own !== own) return;
      if (stage.stage === "text") theirs = stage.text;
      if (stage.stage === "faults") says("failed", stage.faults.map(({ line, text: words }) => `${line ? `line ${line}: ` : ""}${words}`).join("; "));
      if (stage.stage === "verdict") says(stage.outcome === "proved" ? "proved" : "failed", `${stage.headline}: ${stage.reason}`);
      if (stage.stage === "page" && stage.page) frames.theirs.load(stage.page);
      if (stage.stage === "page" && stage.reason) frames.theirs.empty(`There is no live page: ${stage.reason}`);
      if (stage.stage === "ended") says("failed", stage.reason);
    }
  } catch (error) {
    if (compare.own === own) says("failed", error.message);
  }
  differences();
}

// Lines of one side only, by their longest common subsequence.
function differences() {
  if (theirs === null) return;
  const a = theirs.split(/\r\n?|\n/), b = text().split(/\r\n?|\n/);
  const shown = find("theirs").querySelector(".lines");
  if (a.length * b.length > 4e6) { shown.textContent = "The texts are too long to compare here."; return; }
  const size = Array.from({ length: a.length + 1 }, () => new Uint32Array(b.length + 1));
  for (let i = a.length - 1; i >= 0; i--) for (let j = b.length - 1; j >= 0; j--) size[i][j] = a[i] === b[j] ? size[i + 1][j + 1] + 1 : Math.max(size[i + 1][j], size[i][j + 1]);
  const rows = [];
  for (let i = 0, j = 0; i < a.length || j < b.length;) {
    if (i < a.length && j < b.length && a[i] === b[j]) { i++; j++; }
    else if (j >= b.length || (i < a.length && size[i + 1][j] >= size[i][j + 1])) rows.push(make("div", { class: "gone" }, `− ${a[i++]}`));
    else rows.push(make("div", { class: "add" }, `+ ${b[j++]}`));
  }
  shown.replaceChildren(...(rows.length ? rows : ["none"]));
}

// ---- file

function banner(news, choices = {}) {
  find("news").textContent = news;
  find("choices").replaceChildren(...Object.entries(choices).map(([label, act]) => make("button", { type: "button", onclick: () => { find("banner").hidden = true; act(); } }, label)));
  find("banner").hidden = !news;
}

let saving = false, saves = 0;
async function save(version = fetched.version) {
  if (saving) return;
  saving = true;
  const content = text();
  try {
    const [status, answer] = await answered("/save", { text: content, version });
    if (status === 200) { saves++; fetched.version = answer.version; saved = content; conflict = null; banner(""); showState(); }
    else if (status === 409) differs(answer.now, answer.reason);
    else banner(`Not saved: ${answer.reason}.`, { "Download the text": download });
  } catch (error) {
    banner(`Not saved: ${error.message}.`, { "Download the text": download });
  } finally {
    saving = false;
  }
}

function download() {
  const link = make("a", { href: URL.createObjectURL(new Blob([text()], { type: "application/yaml" })), download: fetched.file.name });
  link.click();
  URL.revokeObjectURL(link.href);
}

// The file has another version than this tab: the user decides which one stays.
function differs(now, reason) {
  if (!now.version) {
    fetched.version = "";
    showState();
    banner(`${reason}.`, { "Write it again": () => save("") });
    return;
  }
  if (now.problem) { banner(`The file on disk cannot be edited: ${now.problem}.`, { "Download the text": download, "Overwrite it with this text": () => save(now.version) }); return; }
  conflict = now;
  banner(`${reason}.`, {
    "Load the file, without these edits": () => load(now),
    "Compare": () => { find("other").value = "file"; compare(); differs(now, reason); },
    "Overwrite the file with this text": () => save(now.version),
  });
}

function load(now) {
  fetched.version = now.version;
  saved = now.text.replace(/\r\n?/g, "\n");
  conflict = null;
  if (text() !== saved) replaced(saved);
  showState();
}

// The file may have changed: without edits of the user it is loaded, else the user decides.
async function look(version) {
  if (version === fetched.version || conflict?.version === version) return;
  const before = saves, [, now] = await answered("/file");
  if (now.version === fetched.version || saves !== before) return; // a version before an own one; another event follows
  if (now.version && !now.problem && (text() === saved || text() === now.text.replace(/\r\n?/g, "\n"))) {
    load(now);
    showState("loaded from the disk, where it had changed");
  } else differs(now, now.version ? `${fetched.file.name} was changed by another program or in another tab` : `${fetched.file.name} was removed`);
}

function listen() {
  const events = new EventSource("/events");
  events.onmessage = ({ data }) => {
    alive = true;
    const event = JSON.parse(data);
    if (event.event === "end") { events.close(); gone(); return; }
    showState();
    if (event.event === "file") look(event.version).catch((error) => banner(`${error.message}.`));
    if (event.event === "neighbour") examine();
    if (event.event === "file" && find("other").value === "file") compare();
  };
  events.onerror = () => gone();
}

function gone() {
  alive = false;
  showState();
  if (text() !== saved) banner("The studio has ended; this text is not saved.", { "Download the text": download });
}

addEventListener("beforeunload", (event) => { if (view && text() !== saved) event.preventDefault(); });
find("save").onclick = () => save();
find("other").onchange = compare;

try {
  const [[, file], [, lists]] = await Promise.all([answered("/file"), answered("/lists")]);
  Object.assign(fetched, { file, version: file.version, schema: lists.schema });
  find("name").textContent = file.name;
  find("other").append(make("optgroup", { label: "packaged graphs" }, ...lists.graphs.map((name) => make("option", { value: name }, name))));
  view = editor();
  saved = text();
  if (file.problem) banner(`This file cannot be edited: ${file.problem}.`);
  else if (!file.writable) banner("This file may not be written by you: edits can be tried, not saved.");
  showState();
  listen();
  examine();
} catch (error) {
  fails("The studio could not be loaded", error.message);
}
