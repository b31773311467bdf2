// What scripts/validate-gltf.sh runs: one line a file and check; exit code 1 if any fails.
import fs from "node:fs";
import http from "node:http";
import path from "node:path";
import { fileURLToPath } from "node:url";
import validator from "gltf-validator";
import { chromium as playwright } from "playwright-core";

const tools = path.dirname(fileURLToPath(import.meta.url));
const files = process.argv.slice(2).map((file) => path.resolve(file));
let failed = false;
const say = (file, passed, text) => {
  failed ||= !passed;
  console.log(`${passed ? "ok    " : "FAILED"} ${path.basename(file)}: ${text}`);
};

for (const file of files) {
  const report = await validator.validateBytes(new Uint8Array(fs.readFileSync(file)), {
    uri: path.basename(file),
    externalResourceFunction: async (uri) =>
      new Uint8Array(fs.readFileSync(path.join(path.dirname(file), decodeURIComponent(uri)))),
  });
  const { numErrors, numWarnings, numInfos, numHints, messages } = report.issues;
  const { totalVertexCount, totalTriangleCount } = report.info;
  say(file, numErrors === 0 && numWarnings === 0,
    `validator ${report.validatorVersion}: ${numErrors} errors, ${numWarnings} warnings, ${numInfos} infos, ${numHints} hints; ` +
    `${totalVertexCount} vertices, ${totalTriangleCount} triangles`);
  for (const m of messages.slice(0, 10)) console.log(`         ${m.code} ${m.pointer ?? ""}: ${m.message}`);
}

const page = `<!doctype html><canvas id="view" width="512" height="512"></canvas>
<script type="importmap">{"imports":{"three":"/three/build/three.module.js"}}</script>
<script type="module">
import * as THREE from "three";
import { GLTFLoader } from "/three/examples/jsm/loaders/GLTFLoader.js";
window.check = async (url) => {
  const { scene } = await new GLTFLoader().loadAsync(url);
  const world = new THREE.Scene();
  world.add(scene);
  const meshes = [], names = new Set();
  scene.traverse((o) => { if (o.isMesh || o.isPoints) { meshes.push(o);
    Object.keys(o.morphTargetDictionary ?? {}).forEach((n) => names.add(n)); } });
  const coloured = meshes.some((m) => m.geometry.attributes.color);
  world.overrideMaterial = coloured
    ? new THREE.MeshBasicMaterial({ vertexColors: true, side: THREE.DoubleSide })
    : new THREE.MeshNormalMaterial({ flatShading: true, side: THREE.DoubleSide });
  const box = new THREE.Box3().setFromObject(scene), size = box.getSize(new THREE.Vector3()).length();
  const centre = box.getCenter(new THREE.Vector3());
  const camera = new THREE.PerspectiveCamera(30, 1, size / 100, size * 10);
  camera.position.copy(centre).add(new THREE.Vector3(0.5, 0.2, 1.6).multiplyScalar(size));
  camera.lookAt(centre);
  const canvas = document.getElementById("view");
  const renderer = new THREE.WebGLRenderer({ canvas, preserveDrawingBuffer: true });
  const gl = renderer.getContext(), bytes = 4 * canvas.width * canvas.height;
  const shot = () => {
    renderer.render(world, camera);
    const pixels = new Uint8Array(bytes);
    gl.readPixels(0, 0, canvas.width, canvas.height, gl.RGBA, gl.UNSIGNED_BYTE, pixels);
    return pixels;
  };
  const differ = (a, b) => { let n = 0; for (let i = 0; i < bytes; i += 4)
    n += a[i] !== b[i] || a[i + 1] !== b[i + 1] || a[i + 2] !== b[i + 2]; return n; };
  const neutral = shot(), drawn = differ(neutral, new Uint8Array(bytes).map((_, i) => i % 4 === 3 ? 255 : 0));
  const still = [], set = (name, w) => meshes.forEach((m) => { const k = m.morphTargetDictionary?.[name];
    if (k !== undefined) m.morphTargetInfluences[k] = w; });
  for (const name of names) {
    set(name, 1);
    if (differ(shot(), neutral) === 0) still.push(name);
    set(name, 0);
  }
  const vertices = meshes.reduce((n, m) => n + m.geometry.attributes.position.count, 0);
  const finite = meshes.every((m) => [...m.geometry.attributes.position.array].every(Number.isFinite));
  return { revision: THREE.REVISION, meshes: meshes.length, vertices, targets: names.size, coloured, drawn, still, finite,
    size: box.getSize(new THREE.Vector3()).toArray() };
};
window.ready = true;
</script>`;
const types = { ".js": "text/javascript", ".glb": "model/gltf-binary", ".gltf": "model/gltf+json" };
const server = http.createServer((request, response) => {
  const url = decodeURIComponent(new URL(request.url, "http://localhost").pathname);
  const [, first, ...rest] = url.split("/");
  const given = /^\d+$/.test(first) && files[Number(first)];
  const file = first === "three" ? path.join(tools, "node_modules", "three", ...rest)
    : given ? path.join(path.dirname(given), ...rest) : null;
  if (url === "/") return response.setHeader("content-type", "text/html").end(page);
  if (!file || !fs.existsSync(file)) return response.writeHead(404).end();
  response.setHeader("content-type", types[path.extname(file)] ?? "application/octet-stream");
  response.end(fs.readFileSync(file));
}).listen(0, "127.0.0.1");
await new Promise((listening) => server.once("listening", listening));

let executablePath = process.env.CHROMIUM, args = ["--no-sandbox", "--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"];
if (!executablePath) {
  const { default: packed } = await import("@sparticuz/chromium");
  executablePath = await packed.executablePath();
  args = [...packed.args, ...args];
}
const browser = await playwright.launch({ executablePath, args, headless: true });
try {
  const tab = await browser.newPage();
  tab.on("pageerror", (error) => say("page", false, error.message));
  const { port } = server.address();
  await tab.goto(`http://127.0.0.1:${port}/`);
  await tab.waitForFunction("window.ready === true");
  for (const [i, file] of files.entries()) {
    try {
      const found = await tab.evaluate((url) => window.check(url), `/${i}/${encodeURIComponent(path.basename(file))}`);
      const { revision, meshes, vertices, targets, coloured, drawn, still, finite, size } = found;
      const moving = still.length ? `; nothing to be seen of ${still.join(", ")}` : "";
      say(file, meshes > 0 && drawn > 0 && finite && still.length === 0,
        `three.js r${revision}: ${meshes} meshes, ${vertices} vertices, ${targets} morph targets${moving}${coloured ? ", vertex colours" : ""}; ` +
        `${size.map((s) => s.toFixed(3)).join(" x ")} m, ${drawn} pixels`);
      const shots = process.env.PICTURES;
      if (shots) await tab.locator("#view").screenshot({ path: path.join(shots, `${path.basename(file)}.png`) });
    } catch (error) {
      say(file, false, `three.js: ${error.message.split("\n")[0]}`);
    }
  }
} finally {
  await browser.close();
  server.close();
}
process.exit(failed ? 1 : 0);
