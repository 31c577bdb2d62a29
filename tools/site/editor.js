// The editor of the playground: a chart is opened, changed, checked, and kept in a link.
import { defaultKeymap, history, historyKeymap } from "@codemirror/commands";
import { StreamLanguage, bracketMatching, syntaxHighlighting } from "@codemirror/language";
import { lua } from "@codemirror/legacy-modes/mode/lua";
import { lintGutter, setDiagnostics } from "@codemirror/lint";
import { EditorState } from "@codemirror/state";
import { EditorView, drawSelection, highlightActiveLine, keymap, lineNumbers } from "@codemirror/view";
import { classHighlighter } from "@lezer/highlight";
import examples from "examples"; // [{ name, brief, text }]
import style from "./editor.css";
import * as transport from "./transport.js";

export const { ask, follow } = transport;

const PAUSE = 400;         // milliseconds without a key until the chart is loaded
const FIRST = "lamp.lua";

const card = document.createElement("section");
card.id = "editor";
card.className = "card";
card.innerHTML = `
  <div class="head"><h2>Chart</h2>
    <select id="examples" aria-label="Open an example"><option value="">Examples</option></select>
    <button id="open">Open file</button><input id="file" type="file" accept=".lua" aria-label="A chart" hidden>
    <button id="share">Share</button></div>
  <div id="code"></div>
  <p class="none"><span id="verdict" role="status"></span> <a href="index.html">Tutorial, manual, examples</a></p>`;
document.head.append(Object.assign(document.createElement("style"), { textContent: style }));
document.getElementById("problems").after(card);

const find = selector => card.querySelector(selector);
const files = Object.fromEntries(examples.map(({ name, text }) => [name, text]));
let name = FIRST, pause = null;

const view = new EditorView({ parent: find("#code") });

function stateWith(text) {
  return EditorState.create({ doc: text, extensions: [
    lineNumbers(), lintGutter(), history(), drawSelection(), highlightActiveLine(), bracketMatching(),
    StreamLanguage.define(lua), syntaxHighlighting(classHighlighter), EditorView.lineWrapping,
    keymap.of([...defaultKeymap, ...historyKeymap]),
    EditorView.contentAttributes.of({ "aria-label": "The chart, in Lua. Escape, then Tab leaves it" }),
    EditorView.updateListener.of(update => { if (update.docChanged) typed(); }),
  ] });
}

const textNow = () => view.state.doc.toString();

// Links: the chart in the part of the address that is sent to nobody -------------------

async function keepInAddress() {
  const packed = (await transport.pack(textNow())).replace(/\+/g, "-").replace(/\//g, "_").replace(/=+$/, "");
  window.history.replaceState(null, "", "#" + new URLSearchParams({ name, chart: packed }));
}

// Opens what the address names: a chart, an example, or the first one.
async function openAddress() {
  const asked = new URLSearchParams(location.hash.slice(1));
  const chart = asked.get("chart"), example = asked.get("example") || FIRST;
  try {
    if (chart) return open(asked.get("name"), await transport.unpack(chart.replace(/-/g, "+").replace(/_/g, "/")));
  } catch { /* a part of a link */ }
  const isKnown = !chart && Object.hasOwn(files, example);
  return open(isKnown ? example : FIRST, isKnown ? files[example]
    : `error("the link holds no chart that can be read", 0)\n`);
}

async function share() {
  await keepInAddress();
  try {
    await navigator.clipboard.writeText(location.href);
    tell("The link is copied.");
  } catch { tell("The address of the page is the link."); }
}

// Charts --------------------------------------------------------------------------------

function open(wanted, text) {
  name = /^[\w-]+\.lua$/.test(wanted || "") ? wanted : "chart.lua";
  find("#examples").value = "";
  view.setState(stateWith(text));
  return transport.open(name, text, files);
}

function typed() {
  clearTimeout(pause);
  pause = setTimeout(() => { transport.write(textNow()); keepInAddress(); }, PAUSE);
}

async function openFile(file) {
  if (!file) return;
  await open(file.name.replace(/[^\w.-]/g, "_"), await file.text());
  keepInAddress();
}

// Graphviz in wasm knows the widths of Helvetica: a font that is wider gets smaller.
const pen = document.createElement("canvas").getContext("2d");
pen.font = "100px Helvetica,Arial,sans-serif";
document.documentElement.style.setProperty("--narrow",
  Math.min(1, 461.3 / pen.measureText("entry / exit").width));

// Marks: what is wrong, at its line -------------------------------------------------------

function tell(text) { find("#verdict").textContent = text; }

function diagnosticOf(line, usual) {
  const [, at, kind, message] = line.match(/^[^:\s]+(?::(\d+))?: (?:(warning|note|stubbed): )?([^]*)$/) || [null, null, null, line];
  const { from, to } = view.state.doc.line(Math.min(+at || 1, view.state.doc.lines));
  return { from, to, severity: kind ? "warning" : usual, message };
}

function mark(lines) {
  const list = lines.map(line => diagnosticOf(line, "error"));
  view.dispatch(setDiagnostics(view.state, list));
  const warnings = list.filter(({ severity }) => severity == "warning").length, errors = list.length - warnings;
  const count = (number, word) => number ? [`${number} ${word}${number > 1 ? "s" : ""}`] : [];
  tell([...count(errors, "problem"), ...count(warnings, "warning")].join(", ") || "Checked: ok");
}

transport.observe(async chart => {
  if (chart.problems.length) return mark(chart.problems);
  const text = String(await transport.check());
  mark(text.split("\n").filter(line => line && !line.startsWith("  ") && !line.startsWith(name + ": ok")));
});

find("#examples").append(...examples.map(({ name, brief }) =>
  new Option(`${name.replace(".lua", "")}: ${brief}`, name)));
find("#examples").onchange = async event => {
  if (!event.target.value) return;
  await open(event.target.value, files[event.target.value]);
  keepInAddress();
};
find("#open").onclick = () => find("#file").click();
find("#file").onchange = event => openFile(event.target.files[0]);
find("#share").onclick = share;
addEventListener("dragover", event => event.preventDefault());
addEventListener("drop", event => { event.preventDefault(); openFile(event.dataTransfer.files[0]); });
addEventListener("hashchange", openAddress);
openAddress();
