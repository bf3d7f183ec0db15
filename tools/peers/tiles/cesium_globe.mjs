#!/usr/bin/env node
// usage: node cesium_globe.mjs DIR [--latency 50] [--max-level 5] [--lon 0] [--lat 20] [--height 13600000] [--size 640x360] [--out x.png]
// Shows the ellipsoid under the images DIR/z/x/y.png in CesiumJS, looking straight down, and prints one JSON line with the time
// until all tiles of the globe are loaded. Beside it:
//   terrane serve DIR --latency-ms 50
//   terrane fly globe --settle --offscreen --size 640x360 --view HEADING,-LAT,RANGE --overlay 'URL/{z}/{x}/{y}.png,levels=0-5'
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
const { server, stat, port } = await serve({ mounts: { '/data/': path.resolve(a._[0]), '/cesium/': cesium }, pages: { '/': HTML }, latencyMs: +(a.latency ?? 50) });
const b = await openPage({ width, height });
let result;
try {
  await b.page.goto(`http://127.0.0.1:${port}/`, { waitUntil: 'load' });
  const cfg = { maxLevel: +(a['max-level'] ?? 5), lon: +(a.lon ?? 0), lat: +(a.lat ?? 20), height: +(a.height ?? 13600000) };
  result = await b.page.evaluate(async (cfg) => {
    const C = Cesium;
    const w = new C.CesiumWidget('c', { baseLayer: false, skyBox: false, scene3DOnly: true, requestRenderMode: false, msaaSamples: 1, showRenderLoopErrors: false, contextOptions: { webgl: { preserveDrawingBuffer: true } } });
    const s = w.scene;
    s.camera.setView({ destination: C.Cartesian3.fromDegrees(cfg.lon, cfg.lat, cfg.height), orientation: { heading: 0, pitch: -Math.PI / 2, roll: 0 } });
    await new Promise((ok) => { let n = 0; const off = s.postRender.addEventListener(() => { if (++n >= 5) { off(); ok(); } }); }); // start-up is not counted
    const t0 = performance.now();
    w.scene.imageryLayers.addImageryProvider(new C.UrlTemplateImageryProvider({ url: '/data/{z}/{x}/{y}.png', maximumLevel: cfg.maxLevel }));
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
  result = { client: 'CesiumJS', ...result, requests: stat.requests, notFound: stat.notFound, log: b.log.slice(0, 4) };
} catch (e) { result = { client: 'CesiumJS', ok: false, error: String(e).slice(0, 400) }; }
finally { await b.close(); server.close(); server.closeAllConnections(); }
console.log(JSON.stringify(result));
process.exit(result.ok ? 0 : 1);
