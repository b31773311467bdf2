// What the end-to-end tests share: a server on a vault of its own, a headless Chromium, and pictures that are looked at.

import { spawn } from "node:child_process";
import { copyFileSync, existsSync, mkdirSync, mkdtempSync, readFileSync, rmSync } from "node:fs";
import { tmpdir } from "node:os";
import { join } from "node:path";
import { inflateRawSync } from "node:zlib";
import { chromium } from "playwright-core";

export const shots = process.env.STUDIO_SHOTS;
if (shots) mkdirSync(shots, { recursive: true });

/** Starts the program; resolves with its address. */
export function start(program, args) {
  const child = spawn(program, ["--no-open", ...args], { stdio: ["ignore", "pipe", "inherit"] });
  const address = new Promise((resolve, reject) => {
    let text = "";
    child.stdout.on("data", (data) => {
      text += data;
      const line = text.split("\n")[0];
      if (text.includes("\n")) resolve(line.trim());
    });
    child.on("exit", (code) => reject(new Error(`the server ended with ${code}`)));
  });
  return { child, address };
}

export async function browser() {
  const found = [process.env.CHROMIUM, "/usr/bin/chromium", "/usr/bin/chromium-browser", "/usr/bin/google-chrome"].find((path) => path && existsSync(path));
  if (!found) throw new Error("no Chromium here: apt install chromium, or set CHROMIUM");
  const args = ["--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--no-sandbox", "--force-device-scale-factor=1"];
  return chromium.launch({ executablePath: found, args });
}

export async function shot(page, name) {
  if (shots) await page.screenshot({ path: join(shots, `${name}.png`) });
}

/** Variance of the canvas's brightness in a rectangle (shares of its size): a picture of nothing has none. */
export async function variance(page, [left, top, width, height] = [0, 0, 1, 1]) {
  return page.evaluate(
    ([l, t, w, h]) => {
      const canvas = document.querySelector("canvas");
      const copy = document.createElement("canvas");
      [copy.width, copy.height] = [200, 150];
      const context = copy.getContext("2d");
      context.drawImage(canvas, l * canvas.width, t * canvas.height, w * canvas.width, h * canvas.height, 0, 0, 200, 150);
      const { data } = context.getImageData(0, 0, 200, 150);
      let [sum, squares] = [0, 0];
      const count = data.length / 4;
      for (let k = 0; k < data.length; k += 4) {
        const grey = (data[k] + data[k + 1] + data[k + 2]) / 3;
        sum += grey;
        squares += grey * grey;
      }
      return squares / count - (sum / count) ** 2;
    },
    [left, top, width, height],
  );
}

export function check(condition, what) {
  if (!condition) throw new Error(`failed: ${what}`);
  console.log(`ok: ${what}`);
}

/** Waits until something is so. The time is that of a hanging program, not of a slow machine. */
export async function until(what, test, seconds = 180) {
  const end = Date.now() + 1000 * seconds;
  for (;;) {
    const value = await test();
    if (value) return value;
    if (Date.now() > end) throw new Error(`waited ${seconds} s in vain: ${what}`);
    await new Promise((resolve) => setTimeout(resolve, 100));
  }
}

/** Where an element is on the page. It may be drawn anew while it is asked for; then it is asked for again. */
export const box = (locator) => until(`a place on the page for ${locator}`, () => locator.boundingBox());

/** Opens the page and listens to what the server says: the last message of each type, and how many plans there were. */
async function open(chromium, address) {
  const context = await chromium.newContext({ viewport: { width: 1280, height: 720 }, acceptDownloads: true });
  const heard = { plans: 0 };
  context.setDefaultTimeout(180_000);
  const page = await context.newPage();
  page.failures = [];
  page.on("pageerror", (error) => page.failures.push(String(error)));
  page.on("console", (message) => message.type() === "error" && page.failures.push(message.text()));
  page.on("websocket", (socket) =>
    socket.on("framereceived", ({ payload }) => {
      if (typeof payload !== "string") return;
      const message = JSON.parse(payload);
      heard[message.type] = message;
      if (message.type === "plan") heard.plans += 1;
    }),
  );
  await page.goto(address);
  // scan and template come one after the other
  await until("the scan stands there", async () => (await variance(page, [0, 0, 0.35, 1])) > 200);
  await until("the template stands there", async () => (await variance(page, [0.4, 0, 0.3, 1])) > 200);
  return { page, heard };
}

export const idle = (page) => until("nothing runs", async () => !(await page.$(".progress")));
export const mode = (page, name) => page.getByRole("navigation").getByRole("button", { name }).click();

/** Where a file is that the page gives. */
export async function download(page, press, folder) {
  const [given] = await Promise.all([page.waitForEvent("download"), press()]);
  const path = join(folder, given.suggestedFilename());
  copyFileSync(await given.path(), path);
  return path;
}

/** The bytes of a file in a zip file. */
export function unpacked(path, name) {
  const zip = readFileSync(path);
  // the directory at the end says where each file is: its name behind 46 bytes, its bytes behind a head of 30 and two lengths
  let at = zip.readUInt32LE(zip.lastIndexOf("PK\x05\x06", undefined, "latin1") + 16);
  while (zip.toString("latin1", at, at + 4) === "PK\x01\x02") {
    const [method, packed, start] = [zip.readUInt16LE(at + 10), zip.readUInt32LE(at + 20), zip.readUInt32LE(at + 42)];
    const [named, extra, comment] = [28, 30, 32].map((k) => zip.readUInt16LE(at + k));
    if (zip.toString("utf8", at + 46, at + 46 + named) === name) {
      const from = start + 30 + zip.readUInt16LE(start + 26) + zip.readUInt16LE(start + 28);
      const bytes = zip.subarray(from, from + packed);
      return method === 0 ? bytes : inflateRawSync(bytes);
    }
    at += 46 + named + extra + comment;
  }
  throw new Error(`${path} has no ${name}`);
}

/**
 * Does something with a server on a vault in a folder of its own, and cleans up whatever comes. `visit` opens the page, `end` kills
 * the server and `restart` starts another one on the same vault. What fails is kept as a screenshot.
 */
export async function journey(name, program, work) {
  const folder = mkdtempSync(join(tmpdir(), "studio-"));
  const vault = join(folder, "vault");
  const engine = await browser();
  let server = start(program, ["--vault", vault]);
  let current = null;
  const end = () => {
    server.child.removeAllListeners("exit");
    server.child.kill("SIGKILL");
  };
  const visit = async () => {
    const visited = await open(engine, await server.address);
    current = visited.page;
    return visited;
  };
  const restart = (...args) => {
    server = start(program, ["--vault", vault, ...args]);
    return server.address;
  };
  try {
    await work({ folder, vault, visit, end, restart });
  } catch (error) {
    if (current) await shot(current, `failed-${name}`).catch(() => {});
    throw error;
  } finally {
    await engine.close();
    end();
    rmSync(folder, { recursive: true, force: true });
  }
  console.log("all well");
  process.exit(0);
}
