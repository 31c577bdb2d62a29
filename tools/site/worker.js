// Lua and Graphviz, away from the page: a chart can hold up nothing but itself.
import { instance } from "@viz-js/viz";
import { LuaFactory } from "wasmoon";
import wasm from "wasmoon/dist/glue.wasm";
import library from "library"; // { name: text } of the Lua files

const SECONDS = 3;         // of a call of Lua, then the chart is interrupted
const MORE = 0.5;          // for what handles that
const BYTES = 512 * 2 ** 20;
const TOO_LARGE = "the chart takes more than 512 MiB";
const COUNT = 1000;        // instructions between two looks at the clock
const MASK_COUNT = 8;

// wasmoon fetches its file; nothing else can be fetched.
self.fetch = async () => new Response(wasm, { headers: { "Content-Type": "application/wasm" } });

let lua, host, viz, deadline = Infinity, isFollowed = false, timer = null;

const time = () => performance.now() / 1000;

const isLarge = () => lua.module.HEAPU8.length > BYTES;

// Interrupts what goes on for too long, with the line at which it is.
function limit(L) {
  if (time() < deadline && !isLarge()) return;
  deadline = time() + MORE;
  lua.luaL_where(L, 0);
  lua.lua_pushstring(L, isLarge() ? TOO_LARGE : `stopped after ${SECONDS} s, is there a loop without end?`);
  lua.lua_concat(L, 2);
  lua.lua_error(L);
}

async function start(name, text, files) {
  const drawer = instance(), factory = new LuaFactory("glue.wasm");
  for (const file in library) await factory.mountFile("/lib/" + file, library[file]);
  for (const file in files) await factory.mountFile("/" + file, files[file]);
  lua = await factory.getLuaModule();
  const newState = lua.luaL_newstate, hook = lua.module.addFunction(limit, "vii");
  lua.luaL_newstate = () => { // coroutines inherit the hook
    const L = newState();
    lua.lua_sethook(L, hook, MASK_COUNT, COUNT);
    return L;
  };
  const engine = await factory.createEngine({ injectObjects: false, enableProxy: false });
  host = engine.doStringSync(library["host.lua"]);
  viz = await drawer;
  call("open", name, text);
}

// Calls a function of host.lua; the clock of the limit runs meanwhile. Memory that was
// taken is never given back: the page has to begin anew.
function call(name, ...args) {
  deadline = time() + SECONDS;
  const result = host[name](...args);
  deadline = Infinity;
  if (isLarge()) throw TOO_LARGE;
  return result;
}

// A text may hold several graphs; viz.js draws the first of a text.
function draw([text, format]) {
  const graphs = text.split(/(?<=^}\n)(?=digraph )/m);
  try { return graphs.map(graph => viz.renderString(graph, { format, engine: "dot" })).join(""); } catch { return ""; }
}

// Does what is due, and comes back when more is.
function step() {
  if (!host) return;
  clearTimeout(timer);
  let wait = call("step", time());
  for (let wanted; (wanted = call("graph"));) {
    postMessage({ isDrawing: true });
    call("draw", draw(wanted));
    wait = call("step", time());
  }
  for (let text; isFollowed && (text = call("message"));) postMessage({ message: text });
  timer = setTimeout(() => safely(step), Math.min(wait, 60) * 1000);
}

const does = {
  open: ({ name, text, files }) => start(name, text, files),
  write: ({ text }) => call("write", text),
  follow() { isFollowed = true; call("follow"); },
  ask({ path, query, body }) {
    const [status, text] = call("ask", path, query, body);
    return { ok: status < 300, text };
  },
  check: () => call("check"),
};

// What fails here is no failure of a callback: the page begins anew.
async function safely(f) {
  try { await f(); } catch (problem) { postMessage({ failed: String(problem) }); }
}

let before = Promise.resolve(); // one at a time

onmessage = ({ data }) => {
  before = before.then(() => safely(async () => {
    const result = await does[data.does](data);
    step();
    postMessage({ id: data.id, result });
  }));
};
