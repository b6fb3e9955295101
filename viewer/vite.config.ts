import { defineConfig } from "vite";

/** One module: the element, and, loaded as a worker, the decoder. It becomes part of the Python package. */
export default defineConfig({
  publicDir: "public",
  build: {
    outDir: "../src/gsynopsis/viewer_dist",
    emptyOutDir: true,
    target: "es2022",
    minify: true,
    modulePreload: false,
    rolldownOptions: {
      input: "src/lib.ts",
      preserveEntrySignatures: "strict",
      output: { format: "es", entryFileNames: "gsynopsis-viewer.js" },
    },
  },
});
