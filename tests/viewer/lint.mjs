// Types and style of the sources. node lint.mjs VIEWER_JS SOURCES: prints as JSON what `tsc` and `eslint .` would find wrong, and
// how many files each has looked at. Both ask one program, as the compiler takes longer than all rules.
import { createRequire } from "node:module";
import { join } from "node:path";
import { pathToFileURL } from "node:url";

const sources = process.argv[3];
const { resolve } = createRequire(join(sources, "package.json"));
const [{ default: ts }, { ESLint }] = await Promise.all(["typescript", "eslint"].map((name) => import(pathToFileURL(resolve(name)).href)));
const place = join(sources, "tsconfig.json");
const { config } = ts.readConfigFile(place, ts.sys.readFile);
const { fileNames, options, errors } = ts.parseJsonConfigFileContent(config, ts.sys, sources, undefined, place);
const program = ts.createProgram(fileNames, options);
const overrideConfig = { languageOptions: { parserOptions: { programs: [program], projectService: false } } };
const linted = await new ESLint({ cwd: sources, overrideConfig }).lintFiles(["."]);
const style = linted.flatMap(({ filePath, messages }) => messages.map(({ line, message }) => `${filePath}:${line}: ${message}`));
const types = [...errors, ...ts.getPreEmitDiagnostics(program)].map(({ file, messageText }) =>
  `${file?.fileName}: ${ts.flattenDiagnosticMessageText(messageText, " ")}`);
process.stdout.write(JSON.stringify({ types, style, typed: fileNames.length, styled: linted.length }));
