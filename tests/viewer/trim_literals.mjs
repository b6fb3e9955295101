// The build's step that trims shaders and style sheets. node trim_literals.mjs VIEWER_JS SOURCES: prints as JSON, for each
// module with such literals, the text before and after of each of them; then what becomes of some odd lines.
import { readFileSync, readdirSync } from "node:fs";
import { createRequire } from "node:module";
import { join } from "node:path";
import { pathToFileURL } from "node:url";

const sources = process.argv[3];
const { transformWithOxc, parseAst } = await import(pathToFileURL(createRequire(join(sources, "package.json")).resolve("vite")));
const script = async (path) => (await transformWithOxc(readFileSync(path, "utf8"), path)).code;
const code = await script(join(sources, "trim-literals.ts"));
const { trimLiterals, trimShader, trimStyle } = await import(`data:text/javascript,${encodeURIComponent(code)}`);

/** The texts of all template literals, in order. */
function texts(node, found = []) {
  if (Array.isArray(node)) for (const each of node) texts(each, found);
  else if (node && typeof node === "object") {
    if (node.type === "TemplateElement") found.push(node.value.raw);
    for (const each of Object.values(node)) texts(each, found);
  }
  return found;
}

const { transform } = trimLiterals();
const modules = {};
for (const name of readdirSync(sources, { recursive: true })) {
  if (!name.endsWith(".ts") || /node_modules|dist|\.d\.ts/.test(name)) continue;
  const before = await script(join(sources, name));
  const after = transform.call({ parse: parseAst }, before, join(sources, name))?.code;
  if (after) modules[name] = [texts(parseAst(before)), texts(parseAst(after))];
}
const shader = ["a - -b + +c;", "i++ + j;", "#if X\n  a  =  b ; // why\n#endif\n c;", "#define N ", "\n  x\n", " y ", "else if (a) return ;"].map(trimShader);
const style = ["/* why */ .a :not(.b) , c > d { width: calc(100% - 2px) ; }\n"].map(trimStyle);
process.stdout.write(JSON.stringify({ modules, shader, style }));
