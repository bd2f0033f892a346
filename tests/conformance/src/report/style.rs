//! The style sheet of the HTML report, for light and dark colour schemes.

/// The style sheet of a page.
pub(super) const STYLE: &str = "
:root { color-scheme: light dark; --page: #fff; --ink: #1f2937; --soft: #6b7280; --line: #e5e7eb; --card: #f9fafb;
  --good: #15803d; --bad: #b91c1c; --unsure: #a16207; }
@media (prefers-color-scheme: dark) { :root { --page: #0f141b; --ink: #e5e7eb; --soft: #9ca3af; --line: #2b3442;
  --card: #161d27; --good: #4ade80; --bad: #fca5a5; --unsure: #facc15; } }
body { margin: 0 auto; padding: 2rem 1.25rem 4rem; max-width: 70rem; background: var(--page); color: var(--ink);
  font: 16px/1.5 system-ui, sans-serif; }
h1 { font-size: 1.6rem; } h2 { font-size: 1.2rem; margin-top: 2rem; }
table { border-collapse: collapse; width: 100%; font-size: 0.875rem; }
th, td { padding: 0.3rem 0.5rem; text-align: left; vertical-align: top; border-bottom: 1px solid var(--line); }
th { color: var(--soft); }
td.cell { text-align: center; }
.pass, .clean { color: var(--good); } .fail, .wrong, .unclean { color: var(--bad); font-weight: 600; }
.inconclusive, .non-strict, .unsupported { color: var(--unsure); }
.soft { color: var(--soft); }
code, pre { font-family: ui-monospace, monospace; font-size: 0.85em; }
pre { background: var(--card); border: 1px solid var(--line); padding: 0.5rem; overflow-x: auto; white-space: pre-wrap;
  word-break: break-all; }
";
