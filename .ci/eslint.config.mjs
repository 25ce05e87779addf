// What .ci/run asks of our JavaScript: the modules of the live page, and the scripts inside the pages.
const browser = ["window", "document", "console", "fetch", "atob", "Blob", "Response", "DecompressionStream", "ResizeObserver",
  "WebSocket", "location", "matchMedia", "getComputedStyle", "requestAnimationFrame", "performance", "setTimeout", "MutationObserver",
  "TextDecoder", "Event", "IntersectionObserver", "addEventListener", "clearTimeout", "setInterval", "parent"];
const errors = ["no-undef", "no-unused-vars", "no-redeclare", "no-var", "prefer-const", "eqeqeq", "no-shadow", "no-dupe-keys",
  "no-unreachable", "no-fallthrough", "no-self-assign", "no-self-compare", "no-cond-assign", "no-const-assign", "no-dupe-args",
  "no-duplicate-imports", "no-import-assign", "no-unused-expressions", "no-useless-escape", "no-useless-return", "use-isnan",
  "valid-typeof", "no-implicit-globals", "no-eval", "no-implied-eval", "no-unsafe-finally", "no-empty", "no-throw-literal"];

export default [{
  languageOptions: { ecmaVersion: 2024, sourceType: "module", globals: Object.fromEntries(browser.map((name) => [name, "readonly"])) },
  linterOptions: { reportUnusedDisableDirectives: "error" },
  rules: Object.fromEntries(errors.map((name) => [name, "error"])),
}, {
  files: ["scene.js"], // the script of scene.html: the viewer is meshcat's, and the page calls one of two functions
  languageOptions: { sourceType: "script", globals: { MeshCat: "readonly" } },
  rules: { "no-implicit-globals": "off", "no-unused-vars": ["error", { vars: "local" }] },
}];
