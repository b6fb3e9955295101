/** A step of the build: short names for what classes keep to themselves, which minifiers leave as they are. */

import ts from "typescript";
import type { Plugin } from "vite";

interface Text {
  before: string;
  after: string;
}

/** The sources of a folder with tsconfig.json, as the compiler reads them. */
export function readSources(folder: string): ts.Program {
  const place = `${folder}/tsconfig.json`;
  const { config } = ts.readConfigFile(place, (path) => ts.sys.readFile(path)) as { config: object };
  const { fileNames, options } = ts.parseJsonConfigFileContent({ ...config, include: ["src"] }, ts.sys, folder, undefined, place);
  return ts.createProgram(fileNames, options);
}

/** Short names of the private members of all classes; those of one class differ, `$` begins no other name. */
function namesOf(file: ts.SourceFile): Map<ts.Node, string> {
  const found = new Map<ts.Node, string>();
  const visit = (node: ts.Node) => {
    if (ts.isClassLike(node)) {
      const members = node.members.flatMap((member): readonly ts.Declaration[] => (ts.isConstructorDeclaration(member) ? member.parameters : [member]));
      const own = members.filter((member) => ts.getCombinedModifierFlags(member) & ts.ModifierFlags.Private);
      const names = own.map((member) => ts.getNameOfDeclaration(member)!.getText());
      own.forEach((member, i) => found.set(member, `$${names.indexOf(names[i]).toString(36)}`));
    }
    ts.forEachChild(node, visit);
  };
  visit(file);
  return found;
}

/** The texts of the sources, and the same with the short names: of each reference that the compiler knows to be one. */
export function shortened(program: ts.Program): Map<string, Text> {
  const checker = program.getTypeChecker();
  const files = program.getSourceFiles().filter(({ fileName }) => program.getRootFileNames().includes(fileName));
  const names = new Map(files.flatMap((file) => [...namesOf(file)]));
  const nameOf = (symbol?: ts.Symbol) => (symbol?.valueDeclaration ? names.get(symbol.valueDeclaration) : undefined);
  // The compiler is asked of no other identifiers, whose types it would take seconds to know.
  const known = new Set([...names.keys()].map((member) => ts.getNameOfDeclaration(member as ts.Declaration)!.getText()));
  const texts = new Map<string, Text>();
  for (const file of files) {
    let after = "";
    let at = 0;
    const put = (node: ts.Node, text: string) => {
      after += file.text.slice(at, node.getStart()) + text;
      at = node.end;
    };
    const visit = (node: ts.Node) => {
      const { parent } = node;
      if (!ts.isIdentifier(node)) ts.forEachChild(node, visit);
      else if (!known.has(node.text)) return;
      else if (ts.isBindingElement(parent) && parent.name === node && !parent.propertyName) {
        const name = nameOf(checker.getTypeAtLocation(parent.parent).getProperty(node.text));
        if (name) put(node, `${name}: ${node.text}`);
      } else if (ts.isShorthandPropertyAssignment(parent)) {
        const name = nameOf(checker.getShorthandAssignmentValueSymbol(parent));
        if (name) put(node, `${node.text}: ${name}`);
      } else {
        const name = nameOf(checker.getSymbolAtLocation(node));
        if (name) put(node, name);
      }
    };
    visit(file);
    texts.set(file.fileName, { before: file.text, after: after + file.text.slice(at) });
  }
  return texts;
}

/**
 * The same for the sources of a folder. The compiler takes most of the time of a build: what it found is kept among the
 * packages, and holds until a source, a package or this step is another.
 */
function shortenedOnce(folder: string): Map<string, Text> {
  const read = (name: string) => ts.sys.readFile(name) ?? "";
  const hash = (text: string) => ts.sys.createHash!(text);
  const names = ts.sys.readDirectory(`${folder}/src`, [".ts"]).sort();
  const sources = names.map((name) => ({ name: name.slice(folder.length), before: read(name) }));
  const about = ["shorten-privates.ts", "tsconfig.json", "package-lock.json"].map((name) => read(`${folder}/${name}`));
  const key = hash(JSON.stringify([ts.version, about, sources]));
  const kept = `${folder}/node_modules/.shortened`;
  // A build beside this one may be writing it.
  const [of, check, ...content] = read(kept).split("\n");
  const found = content.join("\n");
  if (of === key && check === hash(found)) {
    const after = JSON.parse(found) as string[];
    return new Map(names.map((name, i) => [name, { before: sources[i].before, after: after[i] }]));
  }
  const texts = shortened(readSources(folder));
  const made = JSON.stringify(names.map((name) => texts.get(name)!.after));
  ts.sys.writeFile(kept, `${key}\n${hash(made)}\n${made}`);
  return texts;
}

export function shortenPrivates(): Plugin {
  let folder = "";
  let texts: Map<string, Text>;
  return {
    name: "shorten-privates",
    enforce: "pre",
    configResolved({ root }) {
      folder = root;
    },
    buildStart() {
      texts = shortenedOnce(folder);
    },
    transform(code, id) {
      const found = texts.get(id);
      return found?.before === code ? { code: found.after, map: null } : null;
    },
  };
}
