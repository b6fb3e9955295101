import { defineConfig } from "vite";
import type { UserConfig } from "vite";

/** One module from one entry; `script` is what its workers run, beside it. */
function moduleOf(input: string, name: string, script: string): UserConfig {
  return {
    define: { WORKER_SCRIPT: JSON.stringify(script) },
    build: {
      target: "es2022",
      minify: true,
      modulePreload: false,
      rolldownOptions: {
        input,
        preserveEntrySignatures: "strict",
        output: { format: "es", entryFileNames: name },
      },
    },
  };
}

/** A script of the served page, and beside it what it loads once the first picture is there. */
function firstOf(entry: string, name: string, script: string): UserConfig {
  return {
    publicDir: false,
    define: { WORKER_SCRIPT: JSON.stringify(script) },
    build: {
      target: "es2022",
      outDir: "../src/gsynopsis/viewer_dist",
      emptyOutDir: false,
      // As a library: without Vite's own loader around `import()`.
      lib: { entry, formats: ["es"], fileName: () => name },
      rolldownOptions: {
        // Its later parts import from it, and nobody else does.
        preserveEntrySignatures: "allow-extension",
        output: { minify: true, chunkFileNames: "gsynopsis-[name].js" },
      },
    },
  };
}

/** An object for another engine, without the engine; its workers run what mode `worker` makes, beside it. */
function engineOf(name: string): UserConfig {
  const made = moduleOf(`${name}/index.ts`, `gsynopsis-${name}.js`, "./gsynopsis-worker.js");
  const options = { ...made.build?.rolldownOptions, external: [name] };
  return { ...made, publicDir: false, build: { ...made.build, outDir: `${name}/dist`, emptyOutDir: true, rolldownOptions: options } };
}

/**
 * For any page one file: the element, and, loaded as a worker, the decoder. For the page beside it the same in four, in
 * the modes `first` and `decoder`, so that its first picture does not wait for all of it. All that becomes part of the
 * Python package. For apps with a bundler two, in the modes `element` and `worker`, so that nothing is shipped twice.
 * `headless` is the decoder alone, for Node and workers; `three` and `playcanvas` are packages of their own.
 */
export default defineConfig(({ mode }) => {
  if (mode === "element") return { ...moduleOf("src/package.ts", "gsynopsis-element.js", "./gsynopsis-worker.js"), publicDir: false };
  if (mode === "worker") return { ...moduleOf("src/script.ts", "gsynopsis-worker.js", ""), publicDir: false };
  if (mode === "headless") return { ...moduleOf("src/headless.ts", "gsynopsis-headless.js", ""), publicDir: false };
  if (mode === "three" || mode === "playcanvas") return engineOf(mode);
  if (mode === "first") return firstOf("src/first.ts", "gsynopsis-first.js", "./gsynopsis-decoder.js");
  if (mode === "decoder") return firstOf("src/firstscript.ts", "gsynopsis-decoder.js", "");
  const page = moduleOf("src/lib.ts", "gsynopsis-viewer.js", "./gsynopsis-viewer.js");
  return { ...page, publicDir: "public", build: { ...page.build, outDir: "../src/gsynopsis/viewer_dist", emptyOutDir: true } };
});
