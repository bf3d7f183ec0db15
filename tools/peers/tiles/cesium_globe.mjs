#!/usr/bin/env node
// usage: node cesium_globe.mjs IMAGES [--terrain DIR] [--terrane PROGRAM] [--latency 50] [--max-level 5] [--lon 0] [--lat 20]
//   [--height 13600000] [--size 640x360] [--out x.png] [--urls urls.json]
// Shows the globe under the images IMAGES/z/x/y.png in CesiumJS, looking straight down: the ellipsoid, or the quantized-mesh
// terrain of --terrain (the folder of a layer.json that covers the earth). Prints one JSON line with the time from adding
// terrain and images until all tiles of the globe are loaded, and the number of requests.
// With --terrane the program then shows the same camera from the same server; a second line has its time from the first frame
// (ms), the time of the whole process (processMs), and its requests. Its picture is beside the first, as x.terrane.png.
// Requests are counted by kind too; --urls writes those of each client to a file.
import { spawn } from 'node:child_process';
import fs from 'node:fs';
import os from 'node:os';
import path from 'node:path';
import { fileURLToPath } from 'node:url';
import { serve, parseArgs } from './lib_serve.mjs';
import { openPage } from './lib_browser.mjs';

const here = path.dirname(fileURLToPath(import.meta.url));
const a = parseArgs(process.argv.slice(2));
if (!a._[0]) { console.error('usage: node cesium_globe.mjs DIR [options]; see the head of this file'); process.exit(2); }
const [width, height] = (a.size ?? '640x360').split('x').map(Number);
const HTML = `<!doctype html><html><head><style>html,body,#c,.cesium-widget,.cesium-widget canvas{width:100%;height:100%;margin:0;overflow:hidden;display:block}.cesium-widget-credits{display:none!important}</style>
<script>window.CESIUM_BASE_URL='/cesium/';</script><script src="/cesium/Cesium.js"></script></head><body><div id="c"></div></body></html>`;
const cesium = path.join(here, 'node_modules/cesium/Build/Cesium');
const { server, stat, port } = await serve({ mounts: { '/data/images/': path.resolve(a._[0]), ...(a.terrain && { '/data/terrain/': path.resolve(a.terrain) }), '/cesium/': cesium }, pages: { '/': HTML }, latencyMs: +(a.latency ?? 50) });
const cfg = { terrain: !!a.terrain, maxLevel: +(a['max-level'] ?? 5), lon: +(a.lon ?? 0), lat: +(a.lat ?? 20), height: +(a.height ?? 13600000) };
const b = await openPage({ width, height });
let result;
try {
  await b.page.goto(`http://127.0.0.1:${port}/`, { waitUntil: 'load' });
  result = await b.page.evaluate(async (cfg) => {
    const C = Cesium;
    const w = new C.CesiumWidget('c', { baseLayer: false, skyBox: false, scene3DOnly: true, requestRenderMode: false, msaaSamples: 1, showRenderLoopErrors: false, contextOptions: { webgl: { preserveDrawingBuffer: true } } });
    const s = w.scene;
    s.camera.setView({ destination: C.Cartesian3.fromDegrees(cfg.lon, cfg.lat, cfg.height), orientation: { heading: 0, pitch: -Math.PI / 2, roll: 0 } });
    await new Promise((ok) => { let n = 0; const off = s.postRender.addEventListener(() => { if (++n >= 5) { off(); ok(); } }); }); // start-up is not counted
    const t0 = performance.now();
    if (cfg.terrain) w.terrainProvider = await C.CesiumTerrainProvider.fromUrl('/data/terrain', { requestVertexNormals: true });
    s.imageryLayers.addImageryProvider(new C.UrlTemplateImageryProvider({ url: '/data/images/{z}/{x}/{y}.png', maximumLevel: cfg.maxLevel }));
    const settled = await new Promise((ok) => {
      let good = 0, n = 0, last = 0;
      const off = s.postRender.addEventListener(() => {
        n++;
        if (s.globe.tilesLoaded && n > 3) { if (!good++) last = performance.now() - t0; } else good = 0;
        if (good >= 8 || performance.now() - t0 > 60000) { off(); ok({ ms: Math.round(last), ok: good >= 8, frames: n }); }
      });
    });
    return settled;
  }, cfg);
  if (a.out) await b.page.screenshot({ path: path.resolve(a.out) });
  result = { client: 'CesiumJS', ...result, ...counts(stat.urls), notFound: stat.notFound, log: b.log.slice(0, 4) };
} catch (e) { result = { client: 'CesiumJS', ok: false, error: String(e).slice(0, 400) }; }
const ofCesium = stat.urls.slice();
await b.close();
console.log(JSON.stringify(result));
let ok = result.ok;
if (a.terrane) {
  const own = await terrane();
  console.log(JSON.stringify({ ...own, ofCesiumTime: +(own.ms / result.ms).toFixed(3) }));
  ok &&= own.ok;
}
if (a.urls) fs.writeFileSync(path.resolve(a.urls), JSON.stringify({ cesium: ofCesium, terrane: stat.urls.slice(ofCesium.length) }));
server.close(); server.closeAllConnections();
process.exit(ok ? 0 : 1);

// Counts requests by kind.
function counts(urls) {
  const images = urls.filter((url) => url.startsWith('images/')).length;
  return { requests: urls.length, images, terrain: urls.length - images };
}

// Flies the same camera from the same server.
async function terrane() {
  const { lon, lat } = cfg, rad = Math.PI / 180, url = `http://127.0.0.1:${port}/data`;
  // The distance of the camera from the middle of the earth: WGS84's height along the normal, in one meridian plane.
  const n = 6378137 / Math.sqrt(1 - 0.00669437999014 * Math.sin(lat * rad) ** 2);
  const [x, z] = [(n + cfg.height) * Math.cos(lat * rad), (n * (1 - 0.00669437999014) + cfg.height) * Math.sin(lat * rad)];
  const view = `${((630 - lon) % 360)},${-Math.atan2(z, x) / rad},${Math.hypot(x, z)}`;
  const report = path.join(fs.mkdtempSync(path.join(os.tmpdir(), 'globe-')), 'report.json');
  const args = ['fly', cfg.terrain ? `${url}/terrain/layer.json` : 'globe', '--overlay', `${url}/images/{z}/{x}/{y}.png,levels=0-${cfg.maxLevel}`,
    '--settle', '--offscreen', '--size', `${width}x${height}`, `--view=${view}`, '--report', report];
  if (a.out) args.push('--screenshot', path.resolve(a.out).replace(/(\.png)?$/, '.terrane.png'));
  const before = { requests: stat.urls.length, notFound: stat.notFound }, t0 = performance.now();
  // Not spawnSync: this process answers the requests.
  const [code, log] = await new Promise((done) => {
    const child = spawn(a.terrane, args, { stdio: ['ignore', 'ignore', 'pipe'] });
    let text = ''; child.stderr.on('data', (d) => { text += d; });
    child.on('error', (e) => done([1, String(e)])); child.on('close', (c) => done([c, text]));
  });
  const processMs = Math.round(performance.now() - t0);
  if (code) return { client: 'Terrane', ok: false, log: log.slice(0, 400) };
  const r = JSON.parse(fs.readFileSync(report, 'utf8'));
  fs.rmSync(path.dirname(report), { recursive: true });
  return { client: 'Terrane', ok: r.errors.length === 0, ms: Math.round(1000 * r.converge_s), processMs, frames: r.frames, ...counts(stat.urls.slice(before.requests)), notFound: stat.notFound - before.notFound, errors: r.errors.slice(0, 4) };
}
