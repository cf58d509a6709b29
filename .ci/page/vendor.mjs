// Makes plugins/aiorts_studio/page/vendor/ from the packages of package.json, or with --check compares it with them.
// Why imports are rewritten: `import "preact"` needs an import map. One in the page is a script, which the policy
// `script-src 'self'` refuses, and browsers load none from a file.
import { createHash } from "node:crypto";
import { existsSync, mkdirSync, readFileSync, readdirSync, rmSync, writeFileSync } from "node:fs";
import { dirname, join } from "node:path";
import { fileURLToPath } from "node:url";
import { build } from "esbuild";

const HERE = dirname(fileURLToPath(import.meta.url));
const PACKAGES = join(HERE, "node_modules");
const VENDOR = join(HERE, "../../plugins/aiorts_studio/page/vendor");

/** What a page's module imports -> the file of the package. */
const MODULES = {
  "preact": "preact/dist/preact.mjs",
  "preact/hooks": "preact/hooks/dist/hooks.mjs",
  "@preact/signals-core": "@preact/signals-core/dist/signals-core.mjs",
  "@preact/signals": "@preact/signals/dist/signals.mjs",
  "htm": "htm/dist/htm.mjs",
  "uplot": "uplot/dist/uPlot.esm.js",
};
/** d3-zoom is some 120 small modules of nine packages: the only file that a bundler makes. */
const ZOOM = `export * from "d3-zoom";\nexport { select } from "d3-selection";\n`;

const stemOf = (name) => name.replace("@", "").replaceAll("/", "-");
const text = (path) => readFileSync(join(PACKAGES, path), "utf8");
const manifest = (name) => JSON.parse(text(`${name}/package.json`));
const packageOf = (path) => path.split("/").slice(0, path.startsWith("@") ? 2 : 1).join("/");

/** The module with relative imports and without its map, which is not shipped: a console would report a 404. */
function rewritten(source) {
  return source
    .replace(/(from\s*|import\s*)(["'])([^"'.][^"']*)\2/g, (all, word, quote, name) =>
      name in MODULES ? `${word}${quote}./${stemOf(name)}.js${quote}` : all)
    .replace(/^\/\/# sourceMappingURL=.*\n?/m, "");
}

/** File name -> [bytes, names of the packages that it is made of]. */
async function made() {
  const files = {};
  for (const [name, path] of Object.entries(MODULES)) files[`${stemOf(name)}.js`] = [rewritten(text(path)), [packageOf(path)]];
  files["uplot.css"] = [text("uplot/dist/uPlot.min.css"), ["uplot"]];
  const bundle = await build({
    stdin: { contents: ZOOM, resolveDir: HERE }, bundle: true, format: "esm", minify: true, write: false, metafile: true,
    absWorkingDir: HERE,
  });
  const inside = Object.keys(bundle.metafile.inputs).filter((path) => path.startsWith("node_modules/"));
  files["d3-zoom.js"] = [bundle.outputFiles[0].text, [...new Set(inside.map((path) => packageOf(path.slice(13))))].sort()];
  // The types of a vendored module are those of its package; only `tsc` looks here.
  for (const name of Object.keys(MODULES)) files[`${stemOf(name)}.d.ts`] = [typesOf(name), []];
  files["d3-zoom.d.ts"] = [`import "d3-transition";\n${ZOOM}`, []];
  files["LICENSES.txt"] = [licences(files), []];
  return files;
}

/** htm and uPlot have one export: the default. */
function typesOf(name) {
  return name === "htm" || name === "uplot" ? `export { default } from "${name}";\n` : `export * from "${name}";\n`;
}

/** The list of the files with version, licence and SHA-256, then the text of each licence. */
function licences(files) {
  const rows = [], packages = new Set();
  for (const [file, [bytes, names]] of Object.entries(files)) {
    if (!names.length) continue;
    names.forEach((name) => packages.add(name));
    const said = names.map((name) => `${name} ${manifest(name).version} (${manifest(name).license})`).join(", ");
    rows.push(`${createHash("sha256").update(bytes).digest("hex")}  ${file}  ${said}`);
  }
  const texts = [...packages].sort().map((name) => {
    const file = readdirSync(join(PACKAGES, name)).find((one) => /^licen[cs]e/i.test(one));
    return `${"=".repeat(80)}\n${name} ${manifest(name).version}\n\n${text(`${name}/${file}`).replaceAll("\r", "").trim()}\n`;
  });
  return `Made by .ci/page/vendor.mjs: SHA-256, file, packages. The licences follow.\n\n${rows.join("\n")}\n\n${texts.join("\n")}`;
}

const files = await made();
if (process.argv[2] === "--check") {
  const there = existsSync(VENDOR) ? readdirSync(VENDOR) : [];
  const wrong = [...new Set([...Object.keys(files), ...there])].filter((name) =>
    !files[name] || !there.includes(name) || readFileSync(join(VENDOR, name), "utf8") !== files[name][0]);
  for (const name of wrong) console.error(`${name} is not what the packages of .ci/page/package.json give`);
  process.exitCode = wrong.length ? 1 : 0;
} else {
  rmSync(VENDOR, { recursive: true, force: true });
  mkdirSync(VENDOR, { recursive: true });
  for (const [name, [bytes]] of Object.entries(files)) writeFileSync(join(VENDOR, name), bytes);
}
