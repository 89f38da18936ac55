"""How the quality page looks: one sheet, light and dark, from 360 pixels up.

**Conventions.** Colours are variables; plots refer to them by the same names (`plots.COLOURS`). State is never said by
colour alone. Contrast of text is at least 4.5 : 1 in both schemes (WCAG 2.2, 1.4.3).
"""

STYLE = """
:root{color-scheme:light dark;
--bg:#f4f5f0;--card:#ffffff;--ink:#1c211b;--soft:#566053;--line:#dde1d6;--rail:#e9ece3;
--ok:#2e7d46;--warn:#9a5b00;--bad:#b3261e;--accent:#2f6b3f;
--c0:#1f6fb5;--c1:#c8601a;--c2:#2c8a4b;--c3:#a23d8f;--c4:#7d6425;--c5:#14858a;--c6:#6a54c4;--c7:#b83250}
@media (prefers-color-scheme:dark){:root{
--bg:#14170f;--card:#1d2118;--ink:#e9ede3;--soft:#a6b09f;--line:#363c30;--rail:#2a2f24;
--ok:#6ecb87;--warn:#f0b45a;--bad:#ff8a80;--accent:#8ccf9b;
--c0:#6db6f2;--c1:#f2a065;--c2:#76cf90;--c3:#df8bd0;--c4:#cfb46b;--c5:#5cc9cd;--c6:#ac9cf5;--c7:#f58ba0}}
*{box-sizing:border-box}
html{-webkit-text-size-adjust:100%}
body{margin:0;background:var(--bg);color:var(--ink);
font:16px/1.5 system-ui,-apple-system,"Segoe UI",Roboto,"DejaVu Sans",sans-serif}
header,main,nav,footer{max-width:1120px;margin:0 auto;padding:0 16px}
header{display:flex;flex-wrap:wrap;gap:8px 24px;align-items:center;padding-top:24px}
header div.words{flex:1 1 260px;min-width:0}
h1{font-size:1.5rem;line-height:1.25;margin:0 0 4px;overflow-wrap:anywhere}
h2{font-size:1.15rem;margin:0 0 12px}
h3{font-size:.95rem;margin:0 0 8px}
p{margin:0 0 8px}
.soft,figcaption{color:var(--soft);font-size:.875rem}
a{color:var(--accent)}
:focus-visible{outline:3px solid var(--accent);outline-offset:2px;border-radius:4px}
.skip{position:absolute;left:-999px}
.skip:focus{left:8px;top:8px;background:var(--card);padding:8px 12px;z-index:1}
nav ul{display:flex;flex-wrap:wrap;gap:4px 8px;list-style:none;padding:0;margin:16px 0}
nav a{display:inline-block;padding:4px 12px;border:1px solid var(--line);border-radius:999px;background:var(--card);
color:var(--ink);text-decoration:none;font-size:.875rem}
nav a:hover{border-color:var(--accent)}
section{background:var(--card);border:1px solid var(--line);border-radius:12px;padding:16px;margin:0 0 16px}
.grid{display:grid;gap:16px 24px;grid-template-columns:repeat(auto-fit,minmax(min(100%,300px),1fr))}
.grid>*{min-width:0}
@media (min-width:960px){.grid.wide{grid-template-columns:350px minmax(0,1fr)}}
.grid+p,.scroll+p,.rows+p{margin-top:12px}
.share{font-size:2.25rem;font-weight:600;line-height:1.2;margin:0}
.ring{flex:none;width:112px;height:112px;border-radius:50%;display:grid;place-items:center;
background:radial-gradient(closest-side,var(--bg) 82%,transparent 83%),
conic-gradient(var(--tone) calc(var(--score)*1%),var(--rail) 0)}
.ring b{font-size:2.25rem;line-height:1}
.ring span{display:block;text-align:center;font-size:.75rem;color:var(--soft)}
.good{--tone:var(--ok)}.usable{--tone:var(--warn)}.poor{--tone:var(--bad)}
.verdict{font-weight:600;color:var(--tone)}
ol.lost{list-style:none;margin:0;padding:0}
ol.lost li{display:grid;grid-template-columns:3.2rem minmax(0,1fr);overflow-wrap:anywhere;gap:0 12px;
padding:8px 0;border-top:1px solid var(--line)}
ol.lost li:first-child{border-top:0}
ol.lost b{font-size:1.25rem;text-align:right;color:var(--bad)}
code,.code{font:600 .8125rem ui-monospace,"DejaVu Sans Mono",Menlo,monospace}
.name{font:.8125rem ui-monospace,"DejaVu Sans Mono",Menlo,monospace;overflow-wrap:anywhere}
.sev{display:inline-block;min-width:4.6rem;padding:0 8px;border-radius:999px;border:1px solid;font-size:.75rem;
text-align:center}
.sev.error{color:var(--bad)}.sev.warning{color:var(--warn)}.sev.info{color:var(--soft)}
ul.findings{list-style:none;margin:0;padding:0}
ul.findings li{padding:8px 0;border-top:1px solid var(--line);overflow-wrap:anywhere}
ul.findings li:first-child{border-top:0}
.rows{list-style:none;margin:0;padding:0;display:grid;gap:10px 32px;
grid-template-columns:repeat(auto-fill,minmax(min(100%,440px),1fr))}
.rows .what{display:flex;flex-wrap:wrap;gap:0 12px;justify-content:space-between;font-size:.8125rem}
.rows .what span{color:var(--soft);white-space:nowrap}
svg.strip{display:block;width:100%;height:10px;border-radius:3px;overflow:hidden}
svg.strip.tall{height:22px}
.rail{fill:var(--rail)}.cover{fill:var(--ok)}.gap{fill:var(--bad)}.loose{fill:var(--c0)}
.fixed{fill:var(--ok)}.float{fill:var(--warn)}.other{fill:var(--bad)}
.axis{display:flex;justify-content:space-between;font-size:.75rem;color:var(--soft)}
.legend{display:flex;flex-wrap:wrap;gap:2px 16px;list-style:none;margin:0 0 8px;padding:0;font-size:.8125rem}
.legend li{display:flex;gap:6px;align-items:center;min-width:0}
.swatch{display:inline-block;width:14px;height:10px;border-radius:2px;flex:none;background:var(--soft)}
.swatch.cover,.swatch.fixed{background:var(--ok)}.swatch.float{background:var(--warn)}
.swatch.gap,.swatch.other{background:var(--bad)}.swatch.loose{background:var(--c0)}.swatch.rail{background:var(--rail)}
.swatch.c0{background:var(--c0)}.swatch.c1{background:var(--c1)}.swatch.c2{background:var(--c2)}
.swatch.c3{background:var(--c3)}.swatch.c4{background:var(--c4)}.swatch.c5{background:var(--c5)}
.swatch.c6{background:var(--c6)}.swatch.c7{background:var(--c7)}
figure{margin:0;min-width:0}
figure+.grid,.grid+.grid{margin-top:20px}
figcaption{margin-top:6px}
.plot svg:not(.strip),.plot img{display:block;width:100%;height:auto}
.plot svg:not(.strip){max-width:520px}
.plot svg text{font-family:inherit!important}
.plot img{border-radius:8px;background:var(--rail)}
details{margin-top:8px}
summary{cursor:pointer;color:var(--accent);font-size:.875rem}
.scroll{overflow-x:auto}
table{border-collapse:collapse;font-size:.8125rem;min-width:100%}
caption{text-align:left;color:var(--soft);padding:4px 0}
th,td{padding:4px 10px 4px 0;text-align:left;border-bottom:1px solid var(--line);vertical-align:top;font-weight:400}
thead th{color:var(--soft);white-space:nowrap}
.n{text-align:right;font-variant-numeric:tabular-nums;white-space:nowrap}
td .name,th .name{white-space:nowrap;font-size:.75rem}
footer{padding-top:4px;padding-bottom:32px}
@media print{nav,.skip{display:none}section{break-inside:avoid}}
"""
