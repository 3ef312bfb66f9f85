"""The style sheet and the script of a report, which are part of the page."""

from __future__ import annotations

from html import escape

from .canvas import legible
from .theme import DARK, LIGHT, css_variables

VERDICT_COLOURS = {
    "merged": ("#37b26c", "#48c774"),
    "joined through others": ("#a5d8b9", "#266844"),
    "ambiguous": ("#f0a020", "#f5a623"),
    "kept out": ("#c97b74", "#bc5c54"),
    "unrelated": ("#e9ecef", "#2a2f38"),
}
"""Light and dark theme's colour of each standing of a pair."""

DARK_UNDER_LIGHT_WORDS = ("joined through others", "unrelated")
"""Standings whose colour in the dark theme needs light text."""

_CSS = """
*{box-sizing:border-box}
body{margin:0;font:15px/1.5 system-ui,"DejaVu Sans",sans-serif;background:var(--c0);color:var(--c1)}
main{max-width:76rem;margin:0 auto;padding:1rem 1.25rem 4rem}
header{display:flex;align-items:baseline;gap:1rem;flex-wrap:wrap}
h1{font-size:1.6rem;margin:.4rem 0}
h2{font-size:1.2rem;margin:2.2rem 0 .6rem;padding-bottom:.2rem;border-bottom:1px solid var(--c3)}
h3{font-size:1rem;margin:1.2rem 0 .4rem}
p{margin:.4rem 0;max-width:60rem}
.dim{color:var(--c2)}
button{font:inherit;color:inherit;background:none;border:1px solid var(--c3);border-radius:.4rem;
 padding:.1rem .6rem;cursor:pointer;margin-left:auto}
ul.facts{display:flex;flex-wrap:wrap;gap:.5rem;list-style:none;padding:0;margin:.8rem 0}
ul.facts li{border:1px solid var(--c3);border-radius:.5rem;padding:.35rem .8rem}
ul.facts b{display:block;font-size:1.25rem;line-height:1.3}
.warning{border-left:.25rem solid var(--c7);padding:.1rem .7rem;margin:.4rem 0}
figure{margin:1rem 0;overflow-x:auto}
figure.large{width:min(100vw - 3rem,110rem);position:relative;left:50%;transform:translateX(-50%)}
figure svg{max-width:100%;height:auto;display:block}
@media(max-width:42rem){figure svg{max-width:none;width:40rem}}
details{border:1px solid var(--c3);border-radius:.5rem;margin:.4rem 0;padding:.3rem .8rem}
summary{cursor:pointer}
details>div,details>ol,details>figure{margin:.5rem 0}
ol.pairs{list-style:none;padding:0;margin:.5rem 0}
ol.pairs li{padding:.35rem 0;border-top:1px solid var(--c3);overflow-wrap:anywhere}
ol.pairs li:first-child{border-top:0}
.wide{overflow-x:auto}
table{border-collapse:collapse;font-size:.85rem;font-variant-numeric:tabular-nums}
th,td{padding:.2rem .6rem;text-align:right;border-bottom:1px solid var(--c3);white-space:nowrap}
th:first-child,td:first-child,td.told{text-align:left}
th,td.told{white-space:normal}
th{vertical-align:bottom}
td.told{padding-left:1.6rem;color:var(--c2)}
tr:has(+tr>td.told)>td{border-bottom:none}
pre{overflow-x:auto;font-size:.8rem}
.swatch{display:inline-block;width:.8em;height:.8em;border-radius:.15em;margin-right:.35em;
 vertical-align:-.05em}
.legend{display:flex;flex-wrap:wrap;gap:.2rem 1.2rem;margin:.5rem 0}
#matrix{position:relative}
#matrix svg{width:100%;height:auto;display:block;touch-action:manipulation}
#matrix text{fill:var(--c1)}
#matrix text.s0{fill:var(--t0)}
#matrix text.s1{fill:var(--t1)}
#matrix text.s2{fill:var(--t2)}
#matrix text.s3{fill:var(--t3)}
#matrix text.s4{fill:var(--t4)}
#told{min-height:4.2em;margin:.5rem 0;overflow-wrap:anywhere}
.frame{fill:none;stroke:var(--c2);stroke-width:1.5;vector-effect:non-scaling-stroke}
#spot{fill:none;stroke:var(--c1);stroke-width:2;vector-effect:non-scaling-stroke;
 pointer-events:none}
""".strip()

_SCRIPT = """
"use strict";
const root=document.documentElement;
document.getElementById("theme").onclick=()=>{
  const dark=root.dataset.theme?root.dataset.theme==="dark":
    matchMedia("(prefers-color-scheme: dark)").matches;
  root.dataset.theme=dark?"light":"dark";
};
const data=JSON.parse(document.getElementById("data").textContent);
const at=new Map(data.pairs.map(p=>[p[0]*data.runs.length+p[1],p]));
const spell=p=>`${data.runs[p[0]]} + ${data.runs[p[1]]}: ${data.standings[p[2]]}, `+
  `${p[3].toFixed(1)} bits: ${data.reasons[p[4]]}`;
const svg=document.querySelector("#matrix svg"),told=document.getElementById("told");
if(svg){
  const spot=document.getElementById("spot"),hint=told.textContent;
  let pinned=false;
  const cell=e=>{
    const m=svg.getScreenCTM().inverse(),q=new DOMPoint(e.clientX,e.clientY).matrixTransform(m);
    const j=Math.floor(q.x),i=Math.floor(q.y),n=data.runs.length;
    return i>=0&&j>=0&&i<n&&j<n?[i,j]:null;
  };
  const show=c=>{
    if(!c){told.textContent=hint;spot.setAttribute("visibility","hidden");return}
    const [i,j]=c,p=at.get(Math.min(i,j)*data.runs.length+Math.max(i,j));
    spot.setAttribute("visibility","visible");spot.setAttribute("x",j);spot.setAttribute("y",i);
    const a=data.homes[i],b=data.homes[j],counted=data.counted&&a!==null&&b!==null;
    told.textContent=i===j?data.runs[i]:p?spell(p):`${data.runs[i]} + ${data.runs[j]}: `+
      (counted?`${a===b?"joined through others":"unrelated"}; a large merge does not list it`:
      "not merged together");
  };
  svg.addEventListener("mousemove",e=>{if(!pinned)show(cell(e))});
  svg.addEventListener("mouseleave",()=>{if(!pinned)show(null)});
  svg.addEventListener("click",e=>{const c=cell(e);pinned=!!c&&!pinned;show(c)});
}
for(const box of document.querySelectorAll("details[data-standing]")){
  box.addEventListener("toggle",()=>{
    const list=box.querySelector("ol");
    if(!box.open||list.childElementCount)return;
    const kind=+box.dataset.standing,all=document.createDocumentFragment();
    for(const p of data.pairs)if(p[2]===kind){
      const line=document.createElement("li");line.textContent=spell(p);all.append(line);
    }
    list.append(all);
  },{});
}
""".strip()


def style_sheet(runs: int) -> str:
    """The style sheet with the colours of up to `runs` runs, for the light and the dark theme."""

    def themed(k: int) -> str:
        inks = css_variables((LIGHT, DARK)[k], runs)
        pairs = ";".join(f"--v{i}:{both[k]}" for i, both in enumerate(VERDICT_COLOURS.values()))
        words = (
            (DARK if k and name in DARK_UNDER_LIGHT_WORDS else LIGHT)["ink"]
            for name in VERDICT_COLOURS
        )
        shown = ";".join(f"--t{i}:{word}" for i, word in enumerate(words))
        return f"{inks};{pairs};{shown};color-scheme:{('light', 'dark')[k]}"

    return (
        f":root{{{themed(0)}}}"
        f"@media(prefers-color-scheme:dark){{:root{{{themed(1)}}}}}"
        f':root[data-theme="light"]{{{themed(0)}}}:root[data-theme="dark"]{{{themed(1)}}}\n{_CSS}'
    )


def script() -> str:
    """The script: theme switch, details of the matrix's cells, long lists of pairs."""
    return _SCRIPT


def text(value: object) -> str:
    """Any value as escaped HTML text on one line."""
    return escape(legible(" ".join(str(value).split())), quote=True)
