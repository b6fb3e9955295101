import { defineConfig } from "vite";
import type { UserConfig } from "vite";
import { trimLiterals } from "./trim-literals.ts";
import { shortenPrivates } from "./shorten-privates.ts";

/** One module from one entry; `script` is what its workers run, beside it. */
function moduleOf(input: string, name: string, script: string): UserConfig {
  return {
    publicDir: false,
    plugins: [shortenPrivates(), trimLiterals()],
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

/** A script of the served page, and beside it the chunk that it loads once the first image is on screen. */
function splitOf(entry: string, name: string, script: string): UserConfig {
  return {
    publicDir: false,
    plugins: [shortenPrivates(), trimLiterals()],
    define: { WORKER_SCRIPT: JSON.stringify(script) },
    build: {
      target: "es2022",
      outDir: "../src/gsynopsis/viewer_dist",
      emptyOutDir: false,
      // As a library: without Vite's own loader around `import()`.
      lib: { entry, formats: ["es"], fileName: () => name },
      rolldownOptions: {
        // Its deferred chunk imports from it, and nobody else does.
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
  return { ...made, build: { ...made.build, outDir: `${name}/dist`, emptyOutDir: true, rolldownOptions: options } };
}

/**
 * `page` and `page-worker` make the four scripts of the served page, which are part of the Python package; the chunks
 * that they load later keep the first image from waiting for all of the code. `standalone` is the same in one file,
 * for pages without a bundler. `element` and `worker` are for apps with a bundler, so that nothing is shipped twice.
 * `headless` is the decoder alone, for Node and workers; `three` and `playcanvas` are packages of their own.
 */
export default defineConfig(({ mode }) => {
  switch (mode) {
    case "standalone": return moduleOf("src/entry/standalone.ts", "gsynopsis-viewer.js", "./gsynopsis-viewer.js");
    case "element": return moduleOf("src/entry/element.ts", "gsynopsis-element.js", "./gsynopsis-worker.js");
    case "worker": return moduleOf("src/entry/worker.ts", "gsynopsis-worker.js", "");
    case "headless": return moduleOf("src/entry/decoder.ts", "gsynopsis-headless.js", "");
    case "three":
    case "playcanvas": return engineOf(mode);
    case "page-worker": return splitOf("src/entry/page-worker.ts", "gsynopsis-decoder.js", "");
    default: {
      const page = splitOf("src/entry/page.ts", "gsynopsis-viewer.js", "./gsynopsis-decoder.js");
      return { ...page, publicDir: "public", build: { ...page.build, emptyOutDir: true } };
    }
  }
});
