import { fileURLToPath } from "node:url";
import { defineConfig } from "vite";

const at = (path: string) => fileURLToPath(new URL(path, import.meta.url));

export default defineConfig({
  // A proxy may serve the page under a prefix.
  base: "./",
  resolve: {
    alias: {
      "oviduct-client": at("../clients/typescript/src/index.ts"),
      // The client's sources have no node_modules of their own here.
      fzstd: at("node_modules/fzstd"),
    },
  },
  build: {
    target: "es2022",
    // The policy of the page allows no inline script or data URL.
    assetsInlineLimit: 0,
    modulePreload: { polyfill: false },
    reportCompressedSize: true,
  },
  server: {
    proxy: Object.fromEntries(
      ["models", "batches", "events", "presets", "schema", "workers", "tickets", "healthz", "readyz", "docs", "openapi.yaml"].map(
        // The service lets pages of its own host in.
        (path) => [`/${path}`, { target: process.env["OVIDUCT_URL"] ?? "http://127.0.0.1:8080", changeOrigin: false }],
      ),
    ),
  },
});
