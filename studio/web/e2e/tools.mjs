// Tools of the page that the whole way does not touch: files dropped on it, polygon and sector, pins, what is protected, and a client
// whose history goes through a zip file. `node e2e/tools.mjs STUDIO`.

import { readFileSync, writeFileSync } from "node:fs";
import { join, resolve } from "node:path";
import { box, check, download, idle, journey, mode, shot, until, variance } from "./browser.mjs";

const studio = resolve(process.argv[2]);
const schedule = readFileSync(new URL("../../../src/model/schedules/hybrid.toml", import.meta.url), "utf8");

/** Reads an error and closes it: it lies over the picture. */
async function closed(page, part) {
  const toast = page.locator(".toast.error").filter({ hasText: part });
  const words = await toast.textContent();
  await toast.click();
  await until("it is closed", async () => (await toast.count()) === 0);
  return words;
}

/** Drops files on the page, as from a folder's window. */
async function drop(page, path, content) {
  if (content !== undefined) writeFileSync(path, content);
  const files = [path].flat();
  const session = await page.context().newCDPSession(page);
  for (const type of ["dragEnter", "dragOver", "drop"]) {
    await session.send("Input.dispatchDragEvent", { type, x: 640, y: 400, data: { items: [], files, dragOperationsMask: 1 } });
  }
  await session.detach();
}

/** The step of a preview that is being drawn: the last one. */
const drawn = (heard) => heard.plan?.preview && !heard.plan.error && heard.plan.results[heard.plan.steps.length - 1];

/** Fingers on the page. */
async function fingers(page, moves) {
  const session = await page.context().newCDPSession(page);
  const touch = (type, points) => session.send("Input.dispatchTouchEvent", { type, touchPoints: points.map(([x, y], id) => ({ x, y, id })) });
  await touch("touchStart", moves[0].slice(0, 1));
  await touch("touchStart", moves[0]);
  for (const move of moves) await touch("touchMove", move);
  await touch("touchEnd", []);
  await session.detach();
}

await journey("tools", studio, async ({ folder, visit, end, restart }) => {
  const { page, heard } = await visit();
  const panel = page.locator(".panel");
  await until("a case", () => heard.case);

  // a scan, dropped: what it is is asked, the file is read, and the wrap can use it
  const bump = (x, y) => 40 * Math.cos(x / 40) * Math.cos(y / 60);
  const lines = [];
  for (let k = 0; k < 400; k++) lines.push(`v ${2000 + 5 * (k % 20)} ${7 * Math.floor(k / 20)} ${bump(5 * (k % 20) - 50, 7 * Math.floor(k / 20) - 70)}`);
  for (let r = 0; r < 19; r++) for (let c = 0; c < 19; c++) lines.push(`f ${20 * r + c + 1} ${20 * r + c + 2} ${20 * r + c + 22} ${20 * r + c + 21}`);
  const scans = heard.case.case.scans.length;

  // a scan and its landmarks are no rig, and the scan is brought into view
  const near = lines.map((line) => (line.startsWith("v") ? line.replace(/^v (\S+)/, (_, x) => `v ${x - 1990}`) : line));
  const marks = ["first", "second"].map((name, k) => ({ name, position: [10 + 50 * k, 70, 0] }));
  writeFileSync(join(folder, "near.obj"), `${near.join("\n")}\n`);
  writeFileSync(join(folder, "near.json"), JSON.stringify({ unit: "mm", landmarks: marks }));
  await drop(page, ["near.obj", "near.json"].map((name) => join(folder, name)));
  await page.getByRole("dialog").getByRole("button", { name: "Add" }).click();
  const item = panel.locator(".item");
  await until("the scan with its landmarks", async () => heard.case.case.scans.length === scans + 1 && (await item.count()) === 2);
  await idle(page);
  check(heard.case.case.wrap.pairs.every((pair) => pair.target), "landmarks that are dropped with a scan lie on it");
  await until("the scan is seen", async () => (await variance(page, [0.05, 0.2, 0.3, 0.6])) > 20);
  await shot(page, "20-with-landmarks");
  // keys choose a row of the list, and run nothing
  await item.first().focus();
  for (const key of ["ArrowDown", "Enter"]) await page.keyboard.press(key);
  await until("the second landmark is chosen by keys", async () => (await panel.locator(".item.selected").textContent()).includes("second"));
  check((await panel.locator(".item:focus").textContent()).includes("second") && !(await page.$(".progress")), "the row that keys have chosen keeps the focus");
  for (const left of [1, 0]) {
    await page.keyboard.press("Control+Z");
    await until(`${left} left`, () => heard.case.case.scans.length === scans + left && heard.case.case.wrap.pairs.length === 0);
  }

  // two fingers zoom, and place no landmark
  const still = await variance(page, [0.4, 0, 0.3, 1]);
  const [x, y] = [640, 400];
  await fingers(page, [20, 60, 120, 180].map((d) => [[x - d, y - d / 2], [x + d, y + d / 2]]));
  await until("the template is seen from near", async () => Math.abs((await variance(page, [0.4, 0, 0.3, 1])) - still) > 50);
  check(heard.case.case.wrap.pairs.length === 0, "two fingers place no landmark");
  await shot(page, "20-pinched");
  await page.getByRole("button", { name: "All", exact: true }).click();

  await drop(page, join(folder, "bumpy.obj"), `${lines.join("\n")}\n`);
  await page.getByRole("dialog").getByRole("button", { name: "Add" }).click();
  await until("the dropped scan", () => heard.case.case.scans.length === scans + 1);
  await idle(page);
  check(heard.case.case.scans[scans].name === "bumpy.obj", "a dropped mesh becomes a scan");
  await until("it is seen, though it lies two metres away", async () => (await variance(page, [0, 0, 0.35, 1])) > 100);
  await shot(page, "20-dropped");
  await drop(page, join(folder, "plan.toml"), "[[step]]\nname = 'x'\n[[step.mask]]\nweights = '/etc/passwd'\ndisplacement = [0, 0, 1]\n");
  const words = await closed(page, "passwd");
  check(words.includes("passwd") && words.includes("not in the vault"), `a dropped recipe that names a file is refused: ${words}`);
  await page.keyboard.press("Control+Z");
  await until("the scan is gone", () => heard.case.case.scans.length === scans);
  await until("the first scan is seen again", async () => (await variance(page, [0, 0, 0.35, 1])) > 200);

  // a schedule of one's own: a broken one is refused, a good one makes part of the command
  await drop(page, join(folder, "steps.toml"), "[[level]]\nnodes = 'many'\n");
  const refused = await closed(page, "steps.toml");
  check(refused.includes("no schedule for the model 'hybrid'"), `a broken schedule is refused: ${refused}`);
  await drop(page, join(folder, "quick.toml"), schedule);
  await until("the schedule is kept", () => heard.case.case.wrap.schedule?.file === "quick.toml");
  await panel.getByRole("button", { name: "Wrap", exact: true }).click();
  // what runs ends with the window, so leaving is asked about
  await until("a step", () => heard.step);
  const asked = page.waitForEvent("dialog");
  await page.close({ runBeforeUnload: true });
  const question = await asked;
  check(question.type() === "beforeunload", "a window in which something runs asks before it closes");
  await question.dismiss();
  await until("a result by it", () => heard.case.command?.includes("quick.toml"));
  check(heard.case.command.includes(" --config "), "a schedule of one's own is in the command");
  await idle(page);
  await page.locator("details[data-key=how] summary").click();
  await shot(page, "20-schedule");
  await panel.getByRole("button", { name: "remove the schedule" }).click();
  await until("the model's own again", () => heard.case.case.wrap.schedule === null);

  // a result is shown on its own scan, in its own unit, alone
  const result = panel.getByRole("heading", { name: "Result" });
  const none = panel.getByText("No result on this scan yet.");
  await result.waitFor();
  for (const [list, other, own] of [["scan in work", "1", "0"], ["unit of Scan", "cm", "mm"]]) {
    await panel.getByLabel(list).selectOption(other);
    await none.waitFor();
    check((await result.count()) === 0, `no result with another ${list}`);
    await panel.getByLabel(list).selectOption(own);
    await result.waitFor();
  }

  await mode(page, "Plan");
  await until("a plan", () => heard.plan && !heard.plan.preview);
  await page.getByRole("tab", { name: "Fine sculpting" }).click();
  const steps = heard.plan.steps.length;
  const slide = async (name, value) => {
    const number = page.locator(`[data-key="${name}#"]`);
    await number.fill(String(value));
    await number.press("Tab");
  };

  // a polygon: corners clicked, the first one again closes it
  await panel.getByRole("button", { name: "Polygon", exact: true }).click();
  for (const [x, y] of [[500, 300], [640, 300], [640, 420], [500, 420], [500, 300]]) {
    await page.mouse.move(x, y);
    await page.mouse.down();
    await page.mouse.up();
  }
  await page.locator(".handle").waitFor();
  await slide("move-2", 2);
  const polygon = await until("the polygon moves", () => drawn(heard)?.reached > 1.5 && drawn(heard));
  check(polygon.moving > 50, `a polygon moves ${polygon.moving} vertices by ${polygon.reached.toFixed(2)} mm`);
  await shot(page, "21-polygon");

  // a region of it is protected: fewer vertices move
  await page.locator("details[data-key=protect] summary").click();
  const chips = panel.locator("details[data-key=protect] .chip");
  const regions = await chips.allTextContents();
  let fewer = null;
  for (let k = 0; k < regions.length && !fewer; k++) {
    await chips.nth(k).click();
    fewer = await until("an answer", () => drawn(heard) && heard.plan.steps.at(-1).protects === 1 && drawn(heard));
    if (fewer.moving >= polygon.moving) {
      fewer = null;
      await chips.nth(k).click();
      await until("nothing protected", () => drawn(heard) && heard.plan.steps.at(-1).protects === 0);
    } else check(true, `with ${regions[k]} protected ${fewer.moving} vertices move`);
  }
  check(fewer, `one of ${regions.join(", ")} lies in the polygon`);
  await shot(page, "22-protected");
  await page.keyboard.press("Enter");
  await until("the polygon is kept", () => !heard.plan.preview && heard.plan.steps.length === steps + 1);
  check(heard.plan.steps[steps].protects === 1 && heard.plan.steps[steps].name.startsWith("polygon"), "the kept step protects");

  // pins: points that stay, of a model that has an energy
  await panel.getByRole("button", { name: "Nothing protected" }).click();
  await panel.getByRole("button", { name: "Circle", exact: true }).click();
  await page.mouse.move(570, 500);
  await page.mouse.down();
  await page.mouse.move(640, 500, { steps: 5 });
  await page.mouse.up();
  await page.locator(".handle").waitFor();
  await panel.locator("select").last().selectOption("arap");
  await slide("move-2", 3);
  await until("the disc moves", () => drawn(heard)?.reached > 1 && heard.plan.steps.at(-1).model === "arap");
  await panel.getByRole("button", { name: "Pin", exact: true }).click();
  for (const [k, [x, y]] of [[575, 470], [600, 520]].entries()) {
    await page.mouse.click(x, y);
    await until(`pin ${k + 1}`, () => drawn(heard) && heard.plan.steps.at(-1).pins === k + 1);
  }
  check(true, "two points are pinned");
  await shot(page, "23-pins");
  await page.mouse.click(575, 470);
  await until("one pin", () => drawn(heard) && heard.plan.steps.at(-1).pins === 1);
  await panel.getByRole("button", { name: "Keep", exact: true }).click();
  await until("the pinned step is kept", () => !heard.plan.preview && heard.plan.steps.length === steps + 2);
  const pinned = heard.case.case.plans[0].recipe.match(/vertex = (\d+)/)[1];
  check(heard.plan.steps[steps + 1].pins === 1, `vertex ${pinned} is pinned in the recipe`);
  await panel.getByRole("button", { name: "No pins" }).click();

  // a sector, from its tip outwards
  await panel.getByRole("button", { name: "Sector", exact: true }).click();
  await page.mouse.move(340, 470);
  await page.mouse.down();
  await page.mouse.move(340, 390, { steps: 5 });
  await page.mouse.up();
  await page.locator(".handle").waitFor();
  await slide("move-2", -1);
  const sector = await until("the sector moves", () => drawn(heard)?.reached > 0.3 && drawn(heard));
  await shot(page, "24-sector");
  await page.locator('[data-key="soft#"]').press("Enter");
  await until("the sector is kept by Enter in a field", () => !heard.plan.preview && heard.plan.steps.length === steps + 3);
  check(heard.case.case.plans[0].recipe.includes("sector"), `a sector moves ${sector.moving} vertices`);

  // a recipe with a fault is refused, and its text is there to be corrected
  await panel.getByRole("button", { name: "Recipe as text" }).click();
  const text = page.getByRole("dialog").locator("textarea");
  await text.fill("step = 7");
  await page.getByRole("dialog").getByRole("button", { name: "Use" }).click();
  await page.locator(".toast.error").filter({ hasText: "expected a sequence" }).waitFor();
  check((await text.inputValue()) === "step = 7", "a refused recipe is there to be corrected");
  await page.getByRole("dialog").getByRole("button", { name: "Cancel" }).click();
  await closed(page, "expected a sequence");

  // the history goes with the client, into the zip and out of it
  await mode(page, "Clients");
  const zip = await download(page, () => page.getByRole("button", { name: "Export as zip" }).click(), folder);
  const old = heard.case.id;
  await drop(page, zip);
  await until("the dropped client", () => heard.cases.cases.length === 2 && heard.case.id !== old);
  await mode(page, "Plan");
  await until("its plan", () => heard.plan && !heard.plan.preview && heard.plan.steps.length === steps + 3);
  for (const left of [2, 1, 0]) {
    await page.keyboard.press("Control+Z");
    await until(`undo in the imported client, ${left}`, () => !heard.plan.preview && heard.plan.steps.length === steps + left);
  }
  await page.keyboard.press("Control+Shift+Z");
  await until("redo in the imported client", () => heard.plan.steps.length === steps + 1);
  check(true, "a client dropped as a zip file has its history");
  // Tab leads from client to client, and on
  await mode(page, "Clients");
  await until("the clients", async () => (await page.locator(".card").count()) === 2);
  await page.locator(".card").first().focus();
  for (let k = 0; k < 2; k++) await page.keyboard.press("Tab");
  check((await page.locator("[data-key=client-Name]:focus").count()) === 1, "keys lead from the list to the client's name");

  // what is refused of a client's details is there to be corrected, and what was written after it is not lost
  const [clientName, notes] = ["client-Name", "client-notes"].map((key) => page.locator(`[data-key=${key}]`));
  const named = await clientName.inputValue();
  await clientName.fill("n".repeat(201));
  await notes.fill("Long thought about");
  await notes.press("Tab");
  await closed(page, "at most 200 bytes");
  check((await notes.inputValue()) === "Long thought about", "notes of a refused name are there");
  await clientName.fill(named);
  await clientName.press("Tab");
  await until("both are kept", () => heard.case.case.notes === "Long thought about" && heard.case.case.name === named);
  await until("it says so", async () => (await page.getByText("Not kept yet").count()) === 0);

  // half a screen, one at 200 %, a telephone: everything can be reached
  for (const [width, height] of [[800, 600], [640, 360], [390, 844], [320, 568]]) {
    await page.setViewportSize({ width, height });
    await mode(page, "Clients");
    const field = await box(page.locator(".details input").first());
    check(field.width > 100, `a client's name has ${Math.round(field.width)} px of ${width}`);
    await shot(page, `25-clients-${width}`);
    await mode(page, "Wrap");
    await panel.getByRole("heading", { name: "Files" }).waitFor();
    await shot(page, `25-wrap-${width}`);
    for (const part of ["nav button", "header [aria-label]", "header [role=status]", ".panel .main", ".looks button"]) {
      for (const element of await page.locator(part).all()) {
        const { x, width: own } = await box(element);
        check(x >= 0 && x + own <= width, `${part} lies on a screen of ${width} px`);
      }
    }
    const [left, right] = await Promise.all([0, 1].map((k) => box(page.locator(".pane-label").nth(k))));
    check(right.x - left.x > 100, `a pane has ${Math.round(right.x - left.x)} px of ${width}`);
  }

  await page.setViewportSize({ width: 1280, height: 720 });

  // what is drawn or blended is in no report, and no other client's
  await page.evaluate(() => (window.print = () => {}));
  const report = async () => {
    await mode(page, "Analyse");
    await panel.getByRole("button", { name: "Print report" }).click();
    const pictures = await page.locator("#print img").evaluateAll((images) => images.map((image) => image.src).join());
    await mode(page, "Plan");
    return pictures;
  };
  await mode(page, "Plan");
  await page.getByRole("tab", { name: "Smart operations" }).click();
  await slide("preset-chin-forward", 6);
  await until("the chin", () => !heard.plan.preview && heard.plan.steps.some((s) => s.preset === "chin-forward"));
  await slide("preset-chin-forward", 1e9);
  const far = await closed(page, "chin forward");
  check(far.includes("not taken over"), `a number out of range is refused: ${far}`);
  await until("the number before it", async () => (await page.locator('[data-key="preset-chin-forward#"]').inputValue()) === "6");
  const plain = await report();
  await slide("blend", 0);
  const save = panel.getByRole("button", { name: "obj", exact: true });
  await until("no file of a blend", () => save.isDisabled());
  check((await report()) === plain, "a blend is not in the report");
  await until("no blend any more", async () => (await page.locator('[data-key="blend#"]').inputValue()) === "1" && !(await save.isDisabled()));

  // a blend from a plan that is gone begins before all plans
  await panel.getByRole("button", { name: "Copy", exact: true }).dblclick();
  await page.keyboard.press("Enter");
  await until("the copy", () => heard.case.case.plans.length === 2);
  await panel.getByLabel("blend from").selectOption({ label: "Plan A" });
  await panel.getByLabel("plan in work").selectOption({ label: "Plan A" });
  await panel.getByRole("button", { name: "remove plan" }).click();
  await page.getByRole("dialog").getByRole("button", { name: "Remove" }).click();
  await until("the copy alone", () => heard.case.case.plans.length === 1 && heard.case.case.plans[0].name === "Plan A 2");
  await slide("blend", 0.5);
  await until("a blend", () => save.isDisabled());
  check((await page.locator(".toast.error").count()) === 0 && (await panel.getByLabel("blend from").inputValue()) === "before", "a blend from a plan that is gone");
  await slide("blend", 1);
  await until("no blend", async () => !(await save.isDisabled()));

  await page.getByRole("tab", { name: "Fine sculpting" }).click();
  await panel.getByRole("button", { name: "Pin", exact: true }).click();
  await page.mouse.click(575, 300); // outside of the region that comes
  await until("a pin", async () => (await page.locator("details[data-key=protect] summary").textContent()).endsWith("pins: 1"));
  await panel.getByRole("button", { name: "Circle", exact: true }).click();
  await page.mouse.move(570, 400);
  await page.mouse.down();
  await page.mouse.move(640, 400, { steps: 5 });
  await page.mouse.up();
  await page.locator(".handle").waitFor();
  await until("a model that holds the pin", async () => (await panel.locator("select").last().inputValue()) === "arap");
  await slide("move-2", 5);
  await until("why it cannot be done", () => heard.plan.preview && heard.plan.error);
  await panel.getByRole("button", { name: "Keep", exact: true }).click();
  check((await closed(page, "Not kept")).includes("is to move"), "a region that cannot be done is not kept");
  await panel.getByRole("button", { name: "Pin", exact: true }).click();
  await page.mouse.click(575, 300);
  await page.mouse.click(600, 420);
  await until("the region moves", () => drawn(heard)?.reached > 1);
  check((await report()) === plain, "a region that is not kept is not in the report");
  await page.locator(".handle").waitFor();
  await until("it is there again", () => drawn(heard)?.reached > 1);
  await mode(page, "Clients");
  await page.getByRole("button", { name: "New client" }).click();
  await page.getByRole("dialog").locator("input").fill("Second");
  await page.getByRole("dialog").getByRole("button", { name: "OK" }).click();
  await until("the second client", () => heard.case.case.name === "Second");
  await page.locator(".toast").filter({ hasText: "region that was drawn is gone" }).waitFor();
  await mode(page, "Plan");
  await page.getByRole("tab", { name: "Steps (0)" }).waitFor();
  await page.getByRole("tab", { name: "Fine sculpting" }).click();
  const kept = await page.locator("details[data-key=protect] summary").textContent();
  check(kept === "Protected: 0, pins: 0" && (await page.locator(".handle").count()) === 0, "another client has neither region nor pins of the one before");
  check((await save.isDisabled()) && (await panel.getByRole("button", { name: "Copy as command" }).isDisabled()), "nor its command or face");
  await shot(page, "26-second");

  // what is refused of an article is there to be corrected
  await mode(page, "Knowledge");
  await page.getByRole("button", { name: "New article" }).click();
  await page.locator("[data-key=article-body]").fill("Long thought about");
  const keep = page.getByRole("button", { name: "Save", exact: true });
  await keep.click();
  await closed(page, "needs a title");
  check((await page.locator("[data-key=article-body]").inputValue()) === "Long thought about", "a refused article is there to be corrected");
  await page.locator("[data-key=article-title]").fill("Thought");
  await keep.click();
  await until("it is kept", () => heard.articles.articles.some((article) => article.title === "Thought"));

  // as many plans as have a colour are measured and printed, and one more is refused aloud
  await mode(page, "Plan");
  for (let k = 2; k <= 7; k++) {
    await panel.getByRole("button", { name: "Copy", exact: true }).click();
    await page.keyboard.press("Enter");
    await until(`${k} plans`, () => heard.case.case.plans.length === k);
  }
  await mode(page, "Analyse");
  const chips7 = panel.locator("section").first().locator(".chip");
  for (let k = 0; k < 6; k++) await chips7.nth(k).click();
  await closed(page, "6 plans at most");
  check((await panel.locator("section").first().locator(".chip.on").count()) === 6, "a seventh plan is refused");

  // what is changed while the server is away is done when it is back
  await mode(page, "Plan");
  await page.getByRole("tab", { name: "Smart operations" }).click();
  const port = new URL(page.url()).port;
  end();
  const said = page.locator("header [role=status]");
  await until("the page notices", async () => (await said.textContent()).startsWith("no server"));
  await slide("preset-chin-forward", 4);
  await closed(page, "kept here");
  check((await page.locator('[data-key="preset-chin-forward#"]').inputValue()) === "4" && (await said.textContent()).endsWith("that wait for it: 1"), "a number waits for the server");
  const again = await page.context().newPage();
  await again.goto(await restart("--port", port));
  await until("it is done", () => heard.plan?.steps.some((step) => step.preset === "chin-forward" && step.amount === 4));
  await until("nothing waits", async () => (await said.textContent()) === "all changes saved");
  await again.close();

  const unexpected = page.failures.filter((text) => !/40[01]|ERR_CONNECTION|WebSocket/.test(text));
  check(unexpected.length === 0, `nothing went wrong in the page ${unexpected.join("; ")}`);
});
