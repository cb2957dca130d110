"""How a report looks: on a wide screen, on a telephone, in the dark and on paper."""

STYLE = """
:root {
  color-scheme: light dark;
  --ink: #1c2126; --soft: #59636e; --line: #d4d9de; --page: #ffffff; --panel: #f5f7f9;
  --good: #1a6fb5; --bad: #b3560f; --warn: #fdf3e1; --blue: #2b83c6; --orange: #cc6a1a;
  --green: #1f7a3d; --amber: #8a5a00; --red: #b3261e; --grey: #59636e;
}
@media (prefers-color-scheme: dark) {
  :root {
    --ink: #e4e8ec; --soft: #a3adb7; --line: #3a424a; --page: #14181c; --panel: #1d2328;
    --good: #6db3ee; --bad: #eb9a4f; --warn: #33291a;
    --green: #6cc48a; --amber: #e3b341; --red: #ff8f85; --grey: #a3adb7;
  }
}
* { box-sizing: border-box; }
html { font-size: 16px; -webkit-text-size-adjust: 100%; }
body { margin: 0; background: var(--page); color: var(--ink); font: 1rem/1.5 system-ui, "Segoe UI", Roboto,
  "Helvetica Neue", Arial, sans-serif; }
main { max-width: 70rem; margin: 0 auto; padding: 1.5rem 1rem 3rem; }
h1 { font-size: 1.7rem; line-height: 1.2; margin: 0 0 0.75rem; overflow-wrap: anywhere; }
h2 { font-size: 1.25rem; margin: 2.5rem 0 0.75rem; padding-top: 0.75rem; border-top: 1px solid var(--line); }
.status { display: inline-block; margin: 0 0 1rem; padding: 0.2rem 0.7rem; border: 1px solid currentColor;
  border-radius: 1rem; font-weight: 600; color: var(--good); }
.status.unexplained { color: var(--bad); }
.status.good, .good .light { color: var(--green); }
.status.look, .look .light { color: var(--amber); }
.status.bad, .bad .light { color: var(--red); }
.open .light { color: var(--grey); }
.checks { list-style: none; margin: 0; padding: 0; max-width: 60rem; }
.checks li { display: flex; gap: 0.9rem; padding: 0.5rem 0; border-bottom: 1px solid var(--line); }
.checks div { min-width: 0; overflow-wrap: anywhere; }
.light { flex: none; width: 6.6rem; font-weight: 600; font-size: 0.9rem; }
.light::before { content: ""; display: inline-block; width: 0.75em; height: 0.75em; margin-right: 0.4em;
  border-radius: 50%; background: currentColor; }
.look .light::before { border-radius: 0; transform: rotate(45deg) scale(0.85); }
.bad .light::before { border-radius: 0; }
.open .light::before { background: none; border: 2px solid currentColor; }
.remedy { display: block; color: var(--soft); font-size: 0.9rem; }
.lead { font-size: 1.1rem; max-width: 46rem; margin: 0 0 1rem; }
.about { display: flex; flex-wrap: wrap; gap: 0.25rem 2rem; margin: 0; color: var(--soft); font-size: 0.9rem; }
.about div { display: flex; gap: 0.5rem; min-width: 0; }
.about dd { margin: 0; color: var(--ink); overflow-wrap: anywhere; }
.warnings { margin-top: 1.25rem; padding: 0.75rem 1rem; background: var(--warn); border-left: 4px solid var(--bad); }
.warnings h2 { font-size: 1rem; margin: 0 0 0.25rem; padding: 0; border: 0; }
.warnings ul { margin: 0; padding-left: 1.2rem; overflow-wrap: anywhere; }
.table { overflow-x: auto; margin: 0 0 1.25rem; }
table { border-collapse: collapse; width: 100%; font-size: 0.9rem; font-variant-numeric: tabular-nums; }
caption { caption-side: top; text-align: left; color: var(--soft); padding: 0 0 0.5rem; max-width: 52rem; }
th, td { text-align: left; vertical-align: top; padding: 0.35rem 0.75rem 0.35rem 0;
  border-bottom: 1px solid var(--line); }
thead th { color: var(--soft); font-weight: 600; vertical-align: bottom; }
tbody th { font-weight: 600; }
tbody td, tbody th { max-width: 18rem; }
tbody td:last-child { min-width: 6rem; }
data, .interval { white-space: nowrap; }
.numbers { list-style: none; margin: 0; padding: 0; }
.numbers .name { color: var(--soft); }
.none, .note, figcaption { color: var(--soft); }
.note { font-size: 0.9rem; max-width: 52rem; }
.figures { display: grid; grid-template-columns: repeat(auto-fit, minmax(min(100%, 26rem), 1fr)); gap: 1.25rem 2rem;
  margin: 0 0 1rem; }
figure { margin: 0; min-width: 0; max-width: 40rem; break-inside: avoid; }
figure svg { display: block; width: 100%; height: auto; color: var(--soft); overflow: visible; }
figure svg * { stroke-linejoin: round; stroke-linecap: butt; }
figcaption { font-size: 0.85rem; }
figure.wide { max-width: none; margin: 0 0 1.5rem; scroll-margin-top: 1rem; }
.slim { display: none; }
.key { list-style: none; display: flex; flex-wrap: wrap; gap: 0.25rem 1.25rem; margin: 0 0 1rem; padding: 0;
  font-size: 0.9rem; color: var(--soft); }
.key span { display: inline-block; width: 1.8rem; height: 0.8rem; margin-right: 0.4rem; vertical-align: -0.05rem; }
.key .plus { background: color-mix(in srgb, var(--blue) 34%, transparent); }
.key .minus { background: color-mix(in srgb, var(--orange) 34%, transparent); }
.key .doubt { background: repeating-linear-gradient(135deg, currentColor 0 1px, transparent 1px 5px); }
.key .line { height: 0; border-top: 2px solid currentColor; vertical-align: 0.25rem; }
.key .dotted { border-top-style: dotted; }
.key .model { border-top-color: #c2408f; }
.wide:focus-visible, .table:focus-visible { outline: 2px solid var(--good); outline-offset: 2px; }
.moving path, .moving use { vector-effect: non-scaling-stroke; }
.marks { fill: currentColor; stroke: none; font-size: 9px; }
.marks path { stroke: currentColor; stroke-width: 0.8; }
.shade { fill: currentColor; opacity: 0.2; }
svg [hidden] { display: none; }
.controls { display: flex; flex-wrap: wrap; gap: 0.35rem; align-items: center; margin-bottom: 0.25rem; }
.controls button { min-width: 2rem; padding: 0.15rem 0.5rem; font: inherit; font-size: 0.9rem; color: var(--ink);
  background: var(--panel); border: 1px solid var(--line); border-radius: 0.3rem; cursor: pointer; }
.controls output { color: var(--soft); font-size: 0.85rem; margin-left: 0.5rem; }
code { font-family: ui-monospace, "Cascadia Mono", Menlo, Consolas, monospace; font-size: 0.9em;
  overflow-wrap: anywhere; }
a { color: var(--good); }
svg.bar { width: 7.5rem; height: 1rem; display: block; }
.bar rect { fill: var(--blue); opacity: 0.45; }
.bar path { fill: none; stroke: var(--blue); stroke-width: 2; }
.bar .zero { stroke: var(--soft); stroke-width: 0.7; }
.bar .tick { stroke: var(--ink); stroke-width: 1.6; }
.expression { display: inline-block; min-width: 18rem; overflow-wrap: anywhere; }
#run table { table-layout: fixed; }
#run th:first-child { width: 14rem; overflow-wrap: anywhere; }
#run td { max-width: none; }
footer { margin-top: 3rem; color: var(--soft); font-size: 0.85rem; border-top: 1px solid var(--line); }
@media screen and (max-width: 40rem) {
  main { padding: 1rem 0.9rem 2rem; }
  h1 { font-size: 1.4rem; }
  .lead { font-size: 1rem; }
  .about div { flex-direction: column; gap: 0; }
  table { width: max-content; min-width: 100%; }
  caption { max-width: calc(100vw - 3rem); }
  #run table { width: 100%; }
  #run th:first-child { width: 10.5rem; }
  .slim { display: block; }
  .broad { display: none; }
  .checks li { flex-direction: column; gap: 0.1rem; }
}
@media print {
  :root { --ink: #000000; --soft: #444444; --line: #bbbbbb; --page: #ffffff; --good: #1a6fb5; --bad: #b3560f;
    --warn: #ffffff; --panel: #ffffff; --green: #1f7a3d; --amber: #8a5a00; --red: #b3261e; --grey: #59636e;
    color-scheme: light; }
  @page { margin: 15mm; }
  html { font-size: 11px; }
  main { max-width: none; padding: 0; }
  .key span, .light::before { print-color-adjust: exact; -webkit-print-color-adjust: exact; }
  .table { overflow: visible; }
  .slim { display: none; }
  .broad { display: block; }
  .controls { display: none; }
  .expression { min-width: 0; }
  .figures { grid-template-columns: 1fr 1fr; }
  tr, figure, .warnings { break-inside: avoid; }
  thead { display: table-header-group; }
  h2 { break-after: avoid; }
}
"""
"""Figures take their ink from `color`, so that they follow the page."""
