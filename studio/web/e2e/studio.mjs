// The whole way in a real browser: open the demo, pick landmarks, wrap, correct a point, sculpt, move sliders, undo, save, kill the
// server, reopen; and the command line makes the same bytes from what the page gives. `node e2e/studio.mjs STUDIO NONRIGID`.

import { execFileSync } from "node:child_process";
import { copyFileSync, mkdtempSync, readFileSync, writeFileSync } from "node:fs";
import { join, resolve } from "node:path";
import { box, check, download, idle, journey, mode, shot, unpacked, until, variance } from "./browser.mjs";

const [studio, nonrigid] = process.argv.slice(2).map((path) => resolve(path));
await journey("studio", studio, async ({ folder, vault, visit, end, restart }) => {
  const saved = (page, press) => download(page, press, folder);

  /** Runs a command that the page gives, with this program, in a folder of its own. */
  function replayed(command, files, result) {
    const place = mkdtempSync(join(folder, "run-"));
    for (const [name, path] of Object.entries(files)) copyFileSync(path, join(place, name));
    const line = command.replace(/^nonrigid /, `'${nonrigid}' `);
    execFileSync("sh", ["-c", line], { cwd: place, stdio: ["ignore", "ignore", "inherit"] });
    return readFileSync(join(place, result));
  }

  let { page, heard } = await visit();
  check(!page.url().includes("token"), "the token leaves the address");
  await shot(page, "1-demo");

  // landmarks on scan and template: nose, brows, lower lip
  const points = [
    [232, 423, 697, 397],
    [232, 345, 697, 317],
    [195, 490, 656, 466],
    [269, 490, 738, 466],
    [100, 299, 563, 273],
    [315, 289, 780, 260],
    [233, 577, 697, 558],
  ];
  const whole = () => heard.case?.case.wrap.pairs.filter((p) => p.target && p.vertex !== null).length ?? 0;
  for (const [k, [x, y, u, v]] of points.entries()) {
    await page.mouse.click(x, y);
    await page.mouse.click(u, v);
    await until(`pair ${k + 1}`, () => whole() === k + 1);
  }
  check(whole() === 7, "seven pairs of landmarks are picked");
  await shot(page, "2-landmarks");

  await page.locator(".panel").getByRole("button", { name: "Wrap", exact: true }).click();
  await until("a step", () => heard.step);
  await shot(page, "3-wrapping");
  await idle(page);
  const first = await until("a result", () => heard.case?.case.wrapped);
  check(first.summary.within > 0.9, `wrapped: ${(100 * first.summary.within).toFixed(1)} % within 3 mm`);
  await until("the wrapped template is seen", async () => (await variance(page, [0, 0, 0.35, 1])) > 200);
  await shot(page, "4-wrapped");

  // a corrected point solves again, warm
  await page.mouse.move(195, 490);
  await page.mouse.down();
  await page.mouse.move(193, 488, { steps: 4 });
  const clock = Date.now();
  await page.mouse.up();
  const second = await until("another result", () => heard.case.case.wrapped.mesh.asset !== first.mesh.asset && heard.case.case.wrapped);
  check(second.command.includes("--warm-start"), `a corrected landmark solves again, warm: ${Date.now() - clock} ms to the measured result`);
  await idle(page);

  await page.locator(".panel").getByText("weights").click();
  await page.locator(".weights tr").first().waitFor();
  const wrapped = await saved(page, () => page.locator(".panel").getByRole("button", { name: "obj" }).click());
  const again = replayed(heard.case.command, {}, "wrapped.obj");
  check(unpacked(wrapped, "wrapped.obj").equals(again), "nonrigid register makes the same bytes");
  check(unpacked(wrapped, "wrapped.mtl").length > 0, "the materials come along");

  // sculpt with a brush
  await mode(page, "Plan");
  await page.getByRole("tab", { name: "Fine sculpting" }).click();
  await page.locator(".panel").getByRole("button", { name: "Brush", exact: true }).click();
  await until("a plan", () => heard.plan);
  await page.mouse.move(560, 470);
  await page.mouse.down();
  await page.mouse.move(600, 520, { steps: 8 });
  await page.mouse.up();
  const handle = page.locator(".handle");
  await handle.waitFor();
  await until("the mask is drawn", () => heard.plan.preview && heard.plan.results.length === 3);
  const at = await box(handle);
  await page.mouse.move(at.x + at.width / 2, at.y + at.height / 2);
  await page.mouse.down();
  await page.mouse.move(at.x + at.width / 2, at.y - 30, { steps: 12 });
  await page.mouse.up();
  await until("the region follows", () => heard.plan.preview && heard.plan.results[2]?.reached > 0.5);
  await shot(page, "5-brush");
  await page.keyboard.press("Enter");
  await until("three steps", () => !heard.plan.preview && heard.plan.steps.length === 3);
  check(true, "a brush stroke is dragged and kept");

  // three sliders: by mouse, by key, by number
  const times = [];
  await page.getByRole("tab", { name: "Smart operations" }).click();
  const range = page.locator('[data-key="preset-thin-face"]');
  const slider = await box(range);
  await page.mouse.move(slider.x + (slider.width * 5) / 11, slider.y + slider.height / 2);
  await page.mouse.down();
  for (let k = 1; k <= 10; k++) {
    const before = heard.plans;
    await page.mouse.move(slider.x + (slider.width * (50 + 3 * k)) / 110, slider.y + slider.height / 2);
    await until("a frame", () => heard.plans > before && heard.plan.preview);
    times.push(heard.plan.milliseconds);
  }
  await page.mouse.up();
  await until("four steps", () => !heard.plan.preview && heard.plan.steps.length === 4);
  // keys: five presses are one step of the plan
  await page.locator('[data-key="preset-cheekbone"]').focus();
  for (let k = 0; k < 5; k++) await page.keyboard.press("ArrowRight");
  const keyed = () => heard.plan.steps.find((s) => s.preset === "cheekbone")?.amount ?? 0;
  await until("half a millimetre", () => !heard.plan.preview && heard.plan.steps.length === 5 && Math.abs(keyed() - 0.5) < 1e-9);
  check(true, "five presses are half a millimetre");
  const number = page.locator('[data-key="preset-nose-tip#"]');
  await number.fill("1.5");
  await number.press("Enter");
  await until("six steps", () => !heard.plan.preview && heard.plan.steps.length === 6);
  check(true, `three sliders: a frame of the first takes ${Math.max(...times).toFixed(0)} ms at most`);
  await shot(page, "6-sliders");

  await page.getByRole("button", { name: "undo" }).click();
  await until("five steps again", () => !heard.plan.preview && heard.plan.steps.length === 5);
  await page.keyboard.press("Control+Shift+Z");
  await until("six steps again", () => heard.plan.steps.length === 6);
  await page.keyboard.press("Control+Z");
  await until("five steps for good", () => heard.plan.steps.length === 5);
  check(true, "undo and redo");

  const recipe = await saved(page, () => page.getByRole("button", { name: "Save recipe" }).click());
  const morphed = await saved(page, () => page.locator(".panel").getByRole("button", { name: "obj" }).click());
  const bytes = replayed(heard.plan.command, { "plan.toml": recipe }, "morphed.obj");
  check(unpacked(morphed, "morphed.obj").equals(bytes), "nonrigid morph makes the same bytes of the recipe");

  await mode(page, "Analyse");
  await page.locator(".profile .outline").first().waitFor();
  await page.locator(".measures tbody tr").nth(3).click();
  await until("the face is seen", async () => (await variance(page)) > 100);
  check(true, "the face is measured");
  await shot(page, "7-analysis");
  await page.evaluate(() => (window.print = () => {}));
  await page.getByRole("button", { name: "Print report" }).click();
  await page.emulateMedia({ media: "print" });
  const blank = await page.evaluate(async () => {
    const image = document.querySelector("#print img");
    await image.decode();
    return image.naturalWidth < 100 || image.src.length < 5000;
  });
  check(!blank, "the printed report has pictures");
  if (process.env.STUDIO_SHOTS) await page.screenshot({ path: join(process.env.STUDIO_SHOTS, "8-print.png"), fullPage: true });
  await page.emulateMedia({ media: "screen" });

  await mode(page, "Compare");
  for (const model of ["hybrid", "arap"]) await page.locator(".panel").getByRole("button", { name: model, exact: true }).click();
  await page.locator(".panel").getByRole("button", { name: "Compare", exact: true }).click();
  await until("two models", async () => (await page.locator(".panel .numbers tr").count()) === 3);
  await idle(page);
  await until("both are seen", async () => (await variance(page, [0, 0, 0.5, 1])) > 200 && (await variance(page, [0.5, 0, 0.5, 1])) > 200);
  check(true, "models are compared");
  await shot(page, "9-compare");

  await mode(page, "Knowledge");
  await page.locator(".card").nth(19).waitFor();
  await shot(page, "10-knowledge");
  await mode(page, "Clients");
  await page.locator(".card").first().waitFor();
  await shot(page, "11-clients");
  await page.keyboard.press("?");
  await page.locator("#help").waitFor();
  await shot(page, "12-help");
  const before = heard.case.case;
  check(page.failures.length === 0, `nothing went wrong in the page ${page.failures.join("; ")}`);

  // kill -9, and everything is there again
  end();
  await until("the page notices", async () => (await page.locator("header .doubt").count()) === 1);
  await page.context().close();
  restart();
  ({ page, heard } = await visit());
  check(JSON.stringify(heard.case.case) === JSON.stringify(before), "after kill -9 everything is there");
  await mode(page, "Plan");
  await until("the plan", () => heard.plan?.steps.length === 5);
  await page.keyboard.press("Control+Z");
  await until("undo goes on", () => heard.plan.steps.length === 4);
  check(page.failures.length === 0, `nothing went wrong in the page ${page.failures.join("; ")}`);

  // another client by its exported file, from the page's own dialog
  await mode(page, "Clients");
  const zip = await saved(page, () => page.getByRole("button", { name: "Export as zip" }).click());
  const [chooser] = await Promise.all([page.waitForEvent("filechooser"), page.getByRole("button", { name: "Import" }).click()]);
  await chooser.setFiles(zip);
  await until("two clients", () => heard.cases?.cases.length === 2);
  await page.locator(".details").getByRole("button", { name: "Delete" }).click();
  await page.getByRole("button", { name: "Delete for good" }).click();
  await until("one client", () => heard.cases.cases.length === 1);
  check(true, "a client is exported, imported and deleted");
  writeFileSync(join(folder, "bad.ply"), "ply\nformat ascii 1.0\nelement vertex nonsense\n");
  await page.locator(".card").first().click();
  await mode(page, "Wrap");
  const [bad] = await Promise.all([page.waitForEvent("filechooser"), page.locator(".panel").getByRole("button", { name: "Change" }).last().click()]);
  await bad.setFiles(join(folder, "bad.ply"));
  const words = await page.locator(".toast.error").first().textContent();
  check(words.includes("bad.ply") && !words.includes(vault), `a broken file is answered in words: ${words}`);
});
