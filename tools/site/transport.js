// How the page reaches its machine: as the block of this name in rfsm/web/page.html, but
// the server is a worker. What goes on for too long is ended, and the page goes on.
import source from "worker"; // the text of the worker, deflated, as base64

const PATIENCE = 10;       // seconds for an answer
const DRAWING = 60;        // seconds for a picture

let worker = null, replies = new Map(), last = 0, watch = null, opened = null;
let take = null;           // of the page, for messages
let seen = () => {};       // of the editor, for charts

// Unpacks a text that pack has packed.
export async function unpack(base64) {
  const bytes = Uint8Array.from(atob(base64), c => c.charCodeAt(0));
  return new Response(new Blob([bytes]).stream()
    .pipeThrough(new DecompressionStream("deflate-raw"))).text();
}

export async function pack(text) {
  const bytes = new Uint8Array(await new Response(new Blob([text]).stream()
    .pipeThrough(new CompressionStream("deflate-raw"))).arrayBuffer());
  return btoa(Array.from(bytes, byte => String.fromCharCode(byte)).join(""));
}

const address = unpack(source).then(text =>
  URL.createObjectURL(new Blob([text], { type: "text/javascript" })));

// Ends the worker if it does not answer for some seconds from now on.
function guard(seconds) {
  clearTimeout(watch);
  watch = replies.size ? setTimeout(() => stop(`no answer for ${seconds} s`), seconds * 1000) : null;
}

// Goes on with a chart that says what has happened, until the editor has another one.
function stop(reason) {
  if (opened.isStopped) return; // not a failure of the chart
  const text = `stopped: ${reason}. Change the chart to run it again`;
  open(opened.name, `error(${JSON.stringify(text)}, 0)`, opened.files, true);
}

function receive({ data }) {
  if (data.isDrawing) return guard(DRAWING);
  if (data.failed) return stop(data.failed);
  if (data.message) return take?.({ ...JSON.parse(data.message), server: "page" });
  replies.get(data.id)(data.result);
  replies.delete(data.id);
  guard(PATIENCE);
}

function post(message) {
  return new Promise(resolve => {
    replies.set(++last, resolve);
    worker.postMessage({ ...message, id: last });
    if (!watch) guard(PATIENCE);
  });
}

// Opens a chart in a worker of its own. `files`: what stands beside it.
export async function open(name, text, files, isStopped = false) {
  const url = await address;
  worker?.terminate();
  for (const reply of replies.values()) reply({ ok: false, text: "stopped" });
  replies.clear();
  guard(0);
  opened = { name, files, isStopped };
  worker = new Worker(url);
  worker.onmessage = receive;
  worker.onerror = event => stop(event.message);
  const isOpen = post({ does: "open", name, text, files });
  if (take) post({ does: "follow" });
  return isOpen;
}

export const observe = observer => { seen = observer; };
export function write(text) {
  const { isStopped, name, files } = opened;
  return isStopped ? open(name, text, files) : post({ does: "write", text });
}

export const check = () => post({ does: "check" });

export async function ask(place, body) {
  const [path, query] = place.split("?");
  const reply = await post({ does: "ask", path, query, body });
  if (path == "chart" && reply.ok) seen(JSON.parse(reply.text));
  if (reply.text.startsWith("<?xml")) requestAnimationFrame(() => performance.mark("drawn"));
  return reply;
}

export function follow(_, taker, setLink) {
  take = taker;
  setLink(true);
  if (worker) post({ does: "follow" });
  return { close() { take = null; } };
}
