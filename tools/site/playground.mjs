// Builds playground.html, one file that needs no server: node playground.mjs TARGET DKJSON,
// in the folder of the library. The packages are beside NODE_PATH.
import { createHash } from "node:crypto";
import { readFileSync, readdirSync, writeFileSync } from "node:fs";
import { createRequire } from "node:module";
import { deflateRawSync } from "node:zlib";

const { build } = createRequire(process.env.NODE_PATH + "/")("esbuild");
const [target, dkjson] = process.argv.slice(2);
const here = "tools/site/";
const read = name => readFileSync(name, "utf8");
const filesIn = folder => readdirSync(folder, { recursive: true }).map(name => folder + name);
const die = text => { console.error("playground: " + text); process.exit(1); };

// Files that need sockets, processes or a terminal.
const ABSENT = /^rfsm\/(cli\/(?!review\b)|proto|redis|server|postgres|rtt|fleet|web\/(http|remote))\b/;

function libraryFiles() {
  const names = [...readdirSync(".").filter(name => !name.startsWith(".")), ...filesIn("compat/"), ...filesIn("rfsm/")]
    .filter(name => name.endsWith(".lua") && !ABSENT.test(name));
  const library = Object.fromEntries(names.map(name => [name, read(name)]));
  return { ...library, "dkjson.lua": read(dkjson), "host.lua": read(here + "host.lua"), "rfsm/web/page.html": "" };
}

// The chart of the README comes first, then the other examples and the gallery. The first sentence of each is its brief.
function exampleFiles() {
  const files = ["examples/", "doc/gallery/"].flatMap(folder =>
    readdirSync(folder).filter(name => name.endsWith(".lua")).sort().map(name => ({ name, text: read(folder + name) })));
  const briefOf = text => text.match(/^-- ([^:]*):/)?.[1] ?? text.match(/^-- ([^.(]*)/)[1].replace(/\n--/g, "").trim();
  const [lamp, others] = [true, false].map(isLamp => files.filter(({ name }) => (name === "lamp.lua") === isLamp));
  return [{ ...lamp[0], brief: "the chart of the introduction" },
    ...others.map(file => ({ ...file, brief: briefOf(file.text) }))];
}

// Returns a script for a browser. `modules`: the contents of those that are no files.
async function bundle(entry, modules, globalName) {
  const plugin = { name: "made", setup({ onResolve, onLoad }) {
    onResolve({ filter: new RegExp(`^(${Object.keys(modules).join("|")})$`) },
      ({ path }) => ({ path, namespace: "made" }));
    onLoad({ filter: /./, namespace: "made" },
      ({ path }) => ({ contents: JSON.stringify(modules[path]), loader: "json" }));
  } };
  const { outputFiles } = await build({ entryPoints: [here + entry], bundle: true, minify: true, write: false,
    format: "iife", globalName, target: "es2022", charset: "utf8", legalComments: "none", logLevel: "error",
    nodePaths: [process.env.NODE_PATH], external: ["url", "module", "fs", "path", "crypto", "child_process", "tty"],
    loader: { ".wasm": "binary", ".css": "text" }, plugins: [plugin] });
  return outputFiles[0].text.replaceAll("</script", "<\\/script");
}

const worker = await bundle("worker.js", { library: libraryFiles() });
const transport = await bundle("editor.js", { examples: exampleFiles(),
  worker: deflateRawSync(worker, { level: 9 }).toString("base64") }, "transport");

// The page of the server, with another way to reach the machine.
const BLOCK = /<script nonce="{{token}}" id="transport">[^]*?<\/script>/;
const page = read("rfsm/web/page.html");
if (!BLOCK.test(page)) die("rfsm/web/page.html has no block 'transport'");
const html = page.replace(BLOCK, () => `<script>${transport}</script>`).replaceAll(' nonce="{{token}}"', "");
const hashes = [...html.matchAll(/<script>([^]*?)<\/script>/g)]
  .map(([, text]) => `'sha256-${createHash("sha256").update(text).digest("base64")}'`);
const policy = `default-src 'none'; script-src ${hashes.join(" ")} 'wasm-unsafe-eval'; worker-src blob:; `
  + "style-src 'unsafe-inline'; img-src data:; base-uri 'none'; form-action 'none'";
writeFileSync(target, html.replace('<meta charset="utf-8">', match =>
  `${match}\n<meta http-equiv="Content-Security-Policy" content="${policy}">`));
console.log(`${target}: ${Math.round(Buffer.byteLength(html) / 1024)} KiB`);
