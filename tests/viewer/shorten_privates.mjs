// The build's step that shortens private members. node shorten_privates.mjs VIEWER_JS SOURCES: prints as JSON what the
// compiler finds wrong with the shortened sources, the private names that are left in them, and how many were shortened.
import { readFileSync } from "node:fs";
import { createRequire } from "node:module";
import { join } from "node:path";
import { pathToFileURL } from "node:url";

const sources = process.argv[3];
const { resolve } = createRequire(join(sources, "package.json"));
const [vite, typescript] = ["vite", "typescript"].map((name) => pathToFileURL(resolve(name)).href);
const { transformWithOxc } = await import(vite);
const { default: ts } = await import(typescript);
const path = join(sources, "shorten-privates.ts");
const { code } = await transformWithOxc(readFileSync(path, "utf8"), path);
const step = code.replace('"typescript"', JSON.stringify(typescript));
const { readSources, shortened } = await import(`data:text/javascript,${encodeURIComponent(step)}`);

const program = readSources(sources);
const texts = shortened(program);
const options = program.getCompilerOptions();
const host = ts.createCompilerHost(options);
const read = host.getSourceFile;
host.getSourceFile = (name, language) =>
  texts.has(name) ? ts.createSourceFile(name, texts.get(name).after, language, true) : program.getSourceFile(name) ?? read(name, language);
const after = ts.createProgram(program.getRootFileNames(), options, host);
const wrong = ts.getPreEmitDiagnostics(after).map(({ messageText }) => ts.flattenDiagnosticMessageText(messageText, " "));
const declared = [...texts.values()].flatMap((text) => text.after.match(/\bprivate (?:(?:static|readonly|async|get|set) )*\*?(?!constructor)[\w$]+/g) ?? []);
const names = declared.map((text) => text.split(" ").at(-1).replace("*", ""));
const left = names.filter((name) => !name.startsWith("$"));
const taken = [...texts.values()].flatMap((text) => text.before.match(/(?<![\w$`"'])\$[0-9a-z]+\b/g) ?? []);
process.stdout.write(JSON.stringify({ wrong, left, taken, shortened: names.length }));
