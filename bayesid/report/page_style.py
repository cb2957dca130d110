"""How a report looks: on a wide screen, on a telephone, in the dark and on paper."""

STYLE = """
:root {
  color-scheme: light dark;
  --ink: #1c2126; --soft: #59636e; --line: #d4d9de; --page: #ffffff; --panel: #f5f7f9;
  --good: #1a6fb5; --bad: #b3560f; --warn: #fdf3e1;
}
@media (prefers-color-scheme: dark) {
  :root {
    --ink: #e4e8ec; --soft: #a3adb7; --line: #3a424a; --page: #14181c; --panel: #1d2328;
    --good: #6db3ee; --bad: #eb9a4f; --warn: #33291a;
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
data { white-space: nowrap; }
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
footer { margin-top: 3rem; color: var(--soft); font-size: 0.85rem; border-top: 1px solid var(--line); }
@media (max-width: 40rem) {
  main { padding: 1rem 0.9rem 2rem; }
  h1 { font-size: 1.4rem; }
  .lead { font-size: 1rem; }
  .about div { flex-direction: column; gap: 0; }
  table { width: max-content; min-width: 100%; }
  caption { max-width: calc(100vw - 3rem); }
}
@media print {
  :root { --ink: #000000; --soft: #444444; --line: #bbbbbb; --page: #ffffff; --good: #1a6fb5; --bad: #b3560f;
    --warn: #ffffff; color-scheme: light; }
  @page { margin: 15mm; }
  html { font-size: 11px; }
  main { max-width: none; padding: 0; }
  .table { overflow: visible; }
  .figures { grid-template-columns: 1fr 1fr; }
  tr, figure, .warnings { break-inside: avoid; }
  thead { display: table-header-group; }
  h2 { break-after: avoid; }
}
"""
"""Figures take their ink from `color`, so that they follow the page."""
