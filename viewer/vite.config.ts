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

/**
 * For pages one file, which becomes part of the Python package: the element, and, loaded as a worker, the decoder.
 * For apps with a bundler two, in the modes `element` and `worker`, so that nothing of it is shipped twice.
 */
export default defineConfig(({ mode }) => {
  if (mode === "element") return { ...moduleOf("src/package.ts", "gsynopsis-element.js", "./gsynopsis-worker.js"), publicDir: false };
  if (mode === "worker") return { ...moduleOf("src/script.ts", "gsynopsis-worker.js", ""), publicDir: false };
  const page = moduleOf("src/lib.ts", "gsynopsis-viewer.js", "./gsynopsis-viewer.js");
  return { ...page, publicDir: "public", build: { ...page.build, outDir: "../src/gsynopsis/viewer_dist", emptyOutDir: true } };
});
