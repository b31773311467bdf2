import { defineConfig } from "vite";

// Nothing inline: the server's Content-Security-Policy allows none.
export default defineConfig({
  build: { target: "es2022", assetsInlineLimit: 0, modulePreload: { polyfill: false }, chunkSizeWarningLimit: 1500 },
});
