import { defineConfig } from "vite";

// Relative addresses: the page stands at the root of `octoarm web` and in a folder of the documentation.
export default defineConfig({
  base: "./",
  build: {
    outDir: "../../../agents/octoarm_agents/web/page",
    emptyOutDir: true,
    target: "es2022",
    // The modules are files of their own: only one of the two is loaded.
    assetsInlineLimit: 0,
    modulePreload: { polyfill: false },
  },
});
