/** A step of the build: shaders and style sheets without the space and the comments that are for people. */

import type { Plugin } from "vite";

/** Modules whose literals of several lines are shaders, or style sheets. */
const SHADERS = /\/(render\/(shaders|survey)|engines\/mesh|(three|playcanvas)\/index)\.ts$/;
const STYLES = /\/ui\/(shell|style)\.ts$/;

/** GLSL that means the same: directives keep lines of their own, and no two tokens become one. */
export function trimShader(text: string): string {
  const lines = text.replace(/\/\*[^]*?\*\//g, " ").replace(/\/\/.*/g, "").split("\n").map((line) => line.trim().replace(/\s+/g, " "));
  // What a value beside the text begins or ends with is not known: a space or a break stays there.
  const [first, last] = [/^\s*/, /\s*$/].map((end) => /\n|^./.exec(end.exec(text)![0])?.[0] ?? "");
  const parts: string[] = [];
  for (const line of lines.filter(Boolean)) {
    const before = parts.at(-1);
    if (before === undefined || before.startsWith("#") || line.startsWith("#")) parts.push(line);
    else parts[parts.length - 1] = `${before} ${line}`;
  }
  const tight = parts.map((part) => (part.startsWith("#") ? part : part.replace(/ ?([{}()[\];,=*/<>?:&|!^%]) ?/g, "$1").replace(/ ?([+-]) ?(?![+-])/g, tighten)));
  return parts.length ? first + tight.join("\n") + last : first || last;
}

/** A sign without space around it, if there is not the same before it. */
function tighten(found: string, sign: string, at: number, text: string): string {
  return /[+-]/.test(text[at - 1] ?? "") ? found : sign;
}

/** Style rules that mean the same. */
export function trimStyle(text: string): string {
  return text.replace(/\/\*[^]*?\*\//g, "").replace(/\s+/g, " ").replace(/ ?([{};,>]) ?/g, "$1").replace(/: /g, ":").replace(/;}/g, "}");
}

interface Node {
  readonly type: string;
  readonly start: number;
  readonly end: number;
}

/** The parts of text of all template literals of several lines. */
function partsOf(node: unknown, found: Node[] = []): Node[] {
  if (Array.isArray(node)) for (const each of node) partsOf(each, found);
  else if (node && typeof node === "object") {
    const { type, quasis } = node as { type?: string; quasis?: (Node & { value: { raw: string } })[] };
    if (type === "TemplateLiteral" && quasis?.some(({ value }) => value.raw.includes("\n"))) found.push(...quasis);
    for (const each of Object.values(node)) partsOf(each, found);
  }
  return found;
}

export function trimLiterals(): Plugin {
  return {
    name: "trim-literals",
    enforce: "post",
    transform(code, id) {
      const trim = SHADERS.test(id) ? trimShader : STYLES.test(id) ? trimStyle : null;
      if (!trim) return null;
      let out = code;
      for (const { start, end } of partsOf(this.parse(code)).sort((a, b) => b.start - a.start)) {
        out = out.slice(0, start) + trim(code.slice(start, end)) + out.slice(end);
      }
      return { code: out, map: null };
    },
  };
}
