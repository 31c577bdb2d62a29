// Parses the files named with Mermaid's own parser. Prints what it does not like; with
// --print first, prints each diagram again, from what has been parsed.
import { readFileSync } from "node:fs";
import { JSDOM } from "jsdom";

const { window } = new JSDOM("");
Object.assign(globalThis, { window, document: window.document });
const { default: mermaid } = await import("mermaid");

// Mermaid keeps "#34;" as other characters.
const text = (name) => name.replace(/ﬂ°°?(\w+)¶ß/g, "#$1;");
const end = (state) => (state.start ? "[*]" : state.id);

// A state that is there already gets a row.
function print(statements, seen) {
  for (const one of statements) {
    if (one.stmt === "relation") {
      console.log(`${end(one.state1)} --> ${end(one.state2)}`);
    } else if (one.type === "divider") {
      print(one.doc, seen);
    } else if (one.type === "choice") {
      console.log(`state ${one.id} <<choice>>`);
    } else if (one.stmt === "state" && !one.note && !seen.has(one.id)) {
      seen.add(one.id);
      console.log(`state "${text(one.description)}" as ${one.id}${one.doc ? " {" : ""}`);
      if (one.doc) {
        print(one.doc, seen);
        console.log("}");
      }
    }
  }
}

const isPrinted = process.argv[2] === "--print";
let parsed = 0;
for (const file of process.argv.slice(isPrinted ? 3 : 2)) {
  try {
    const source = readFileSync(file, "utf8");
    await mermaid.parse(source);
    parsed += 1;
    if (isPrinted) {
      console.log(`file ${file}`);
      print((await mermaid.mermaidAPI.getDiagramFromText(source)).db.rootDoc, new Set());
    }
  } catch (problem) {
    console.log(`${file}: ${problem.message}`);
  }
}
if (!isPrinted) console.log(`${parsed} parsed`);
