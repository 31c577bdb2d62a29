// Parses the files named with Mermaid's own parser, and prints what it does not like.
import { readFileSync } from "node:fs";
import { JSDOM } from "jsdom";

const { window } = new JSDOM("");
Object.assign(globalThis, { window, document: window.document });
const { default: mermaid } = await import("mermaid");

let parsed = 0;
for (const file of process.argv.slice(2)) {
  try {
    await mermaid.parse(readFileSync(file, "utf8"));
    parsed += 1;
  } catch (problem) {
    console.log(`${file}: ${problem.message}`);
  }
}
console.log(`${parsed} parsed`);
