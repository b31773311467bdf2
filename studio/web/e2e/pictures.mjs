// The README's pictures: `node e2e/pictures.mjs STUDIO FOLDER FRAMES`; frames of the clip, numbered, go to FRAMES.

import { mkdtempSync, rmSync } from "node:fs";
import { tmpdir } from "node:os";
import { join } from "node:path";
import { box, browser, start, until, variance } from "./browser.mjs";

const [studio, docs, frames] = process.argv.slice(2);
const vault = mkdtempSync(join(tmpdir(), "studio-"));
const server = start(studio, ["--vault", vault]);
const chromium = await browser();
const page = await chromium.newPage({ viewport: { width: 1280, height: 720 } });
await page.goto(await server.address);
await until("the face", async () => (await variance(page)) > 200, 20);

let count = 0;
const film = async (times = 1) => {
  for (let k = 0; k < times; k++) await page.screenshot({ path: join(frames, `${String(count++).padStart(4, "0")}.png`) });
};
const idle = async (filmed) =>
  until("nothing runs", async () => {
    if (filmed) await film();
    return !(await page.$(".progress"));
  });
const drag = async (from, to, steps) => {
  await page.mouse.move(...from);
  await page.mouse.down();
  for (let k = 1; k <= steps; k++) {
    await page.mouse.move(from[0] + ((to[0] - from[0]) * k) / steps, from[1] + ((to[1] - from[1]) * k) / steps);
    await page.waitForTimeout(60);
    await film();
  }
  await page.mouse.up();
};
const mode = (name) => page.getByRole("navigation").getByRole("button", { name }).click();
const panel = page.locator(".panel");

await film(4);
await panel.getByRole("button", { name: "Suggest" }).click();
await idle(true);
await film(3);
await panel.getByRole("button", { name: "Wrap", exact: true }).click();
await page.waitForTimeout(150);
await idle(true);
await page.waitForTimeout(400);
await film(5);
await drag([232, 423], [236, 420], 4);
await page.waitForTimeout(150);
await idle(true);
await film(3);

await mode("Plan");
await page.waitForTimeout(600);
await page.getByRole("button", { name: "¾" }).click();
await film(3);
const range = await box(page.locator('[data-key="preset-nose-tip"]'));
const y = range.y + range.height / 2;
await drag([range.x + range.width * 0.42, y], [range.x + range.width * 0.85, y], 8);
await page.waitForTimeout(300);
await film(3);
await page.getByRole("tab", { name: "Fine sculpting" }).click();
await panel.getByRole("button", { name: "Lasso" }).click();
const centre = [520, 440];
await page.mouse.move(centre[0] + 55, centre[1]);
await page.mouse.down();
for (let k = 1; k <= 24; k++) {
  await page.mouse.move(centre[0] + 55 * Math.cos((k * Math.PI) / 12), centre[1] + 42 * Math.sin((k * Math.PI) / 12));
  if (k % 4 === 0) await film();
}
await page.mouse.up();
await page.waitForTimeout(400);
await film(2);
const handle = await box(page.locator(".handle"));
await drag([handle.x + 9, handle.y + 9], [handle.x + 9, handle.y - 55], 8);
await page.waitForTimeout(400);
await film(2);
await page.screenshot({ path: join(docs, "studio-plan.png") });
await page.keyboard.press("Enter");
await page.waitForTimeout(500);
await mode("Analyse");
await page.locator(".profile .outline").first().waitFor();
await page.waitForTimeout(300);
await film(6);
await page.screenshot({ path: join(docs, "studio-analyse.png") });

await chromium.close();
server.child.removeAllListeners("exit");
server.child.kill();
rmSync(vault, { recursive: true, force: true });
process.exit(0);
