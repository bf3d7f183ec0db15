#!/usr/bin/env node
// usage: node validate.mjs DIR|tileset.json [--quiet] [--no-content] [--no-gltf] [--max-tiles n] [--tol metres] [--subtree FILE --implicit FILE]
// Official JSON schemas (TERRANE_SCHEMA_DIR) + semantic rules of 3D Tiles 1.1 + subtree bitstreams + content headers + Khronos glTF-Validator + geometry-in-volume.
import fs from 'node:fs'; import path from 'node:path'; import { fileURLToPath } from 'node:url';
import Ajv2020 from 'ajv/dist/2020.js';
import * as T from './lib_tiles.mjs'; import { checkGltf } from './lib_gltf.mjs'; import { parseArgs } from './lib_serve.mjs';

const here = path.dirname(fileURLToPath(import.meta.url)), a = parseArgs(process.argv.slice(2));
const SCHEMA = path.resolve(process.env.TERRANE_SCHEMA_DIR || path.join(here, 'schema'));
if (!fs.existsSync(path.join(SCHEMA, 'tileset.schema.json'))) {
  console.error(`validate.mjs: no tileset.schema.json in ${SCHEMA}; set TERRANE_SCHEMA_DIR to the folder specification/schema of github.com/CesiumGS/3d-tiles`);
  process.exit(2);
}
const ajv = new Ajv2020({ strict: false, allErrors: true, validateFormats: false });
const addAll = (d) => { for (const f of fs.readdirSync(d, { withFileTypes: true })) { const p = path.join(d, f.name); if (f.isDirectory()) addAll(p); else if (f.name.endsWith('.schema.json')) { const j = JSON.parse(fs.readFileSync(p)); j.$id = 'file:///' + path.relative(SCHEMA, p); ajv.addSchema(j); } } };
addAll(SCHEMA);
const vTileset = ajv.getSchema('file:///tileset.schema.json'), vSubtree = ajv.getSchema('file:///Subtree/subtree.schema.json');

const issues = []; const counts = { tilesets: 0, tiles: 0, contents: 0, subtrees: 0, implicitTiles: 0, glb: 0, b3dm: 0, i3dm: 0, pnts: 0, cmpt: 0, gltf: 0, geojson: 0, bytes: 0, triangles: 0, vertices: 0, maxDepth: 0, extensions: {} };
const add = (sev, type, where, msg) => { issues.push({ sev, type, where, msg: String(msg).slice(0, 240) }); };
const err = (t, w, m) => add('error', t, w, m), warn = (t, w, m) => add('warning', t, w, m);
const soft = (e) => e.keyword === 'minItems' && /\/children$/.test(e.instancePath);
const schema = (v, j, w) => { if (!v(j)) for (const e of v.errors.slice(0, 10)) (soft(e) ? warn : err)('SCHEMA', w + e.instancePath, `${e.message} ${JSON.stringify(e.params)}`); return !v.errors?.some((e) => !soft(e)); };
const ext = (o) => { const s = new Set(); const walk = (x) => { if (Array.isArray(x)) x.forEach(walk); else if (x && typeof x === 'object') { if (x.extensions && typeof x.extensions === 'object') for (const k of Object.keys(x.extensions)) s.add(k); for (const k of Object.keys(x)) if (k !== 'extras') walk(x[k]); } }; walk(o); return s; };
const isUrl = (u) => /^(https?|data|blob):/i.test(u);
const tol = +(a.tol ?? 0.05), maxTiles = +(a['max-tiles'] ?? 200000);
const read = (f) => { const raw = fs.readFileSync(f); counts.bytes += raw.length; return T.gunzipIf(raw); };
const KNOWN = new Set(['3DTILES_content_gltf', '3DTILES_multiple_contents', '3DTILES_implicit_tiling', '3DTILES_metadata', '3DTILES_bounding_volume_S2', '3DTILES_ellipsoid', '3DTILES_draco_point_compression', '3DTILES_batch_table_hierarchy', '3DTILES_content_conditional', '3DTILES_bounding_volume_cylinder', '3DTILES_content_voxels', '3DTILES_content_gltf_vector', '3DTILES_layer', 'CESIUM_primitive_outline']);

function volOk(v, w) {
  if (!v || typeof v !== 'object') return false;
  if (v.region) { const [x0, y0, x1, y1, z0, z1] = v.region; if (Array.isArray(v.region) && v.region.length === 6 && v.region.every(Number.isFinite)) { for (const [n, x, l] of [['west', x0, Math.PI], ['east', x1, Math.PI], ['south', y0, Math.PI / 2], ['north', y1, Math.PI / 2]]) if (Math.abs(x) > l + 1e-9) err('BOUNDING_VOLUME_INVALID', w, `region ${n} ${x} out of range (radians)`); if (y0 > y1) err('BOUNDING_VOLUME_INVALID', w, 'south > north'); if (z0 > z1) err('BOUNDING_VOLUME_INVALID', w, 'minimum height > maximum height'); } else return false; }
  if (v.sphere && !(v.sphere[3] >= 0)) err('BOUNDING_VOLUME_INVALID', w, 'sphere radius');
  return !!(v.box?.length === 12 || v.region || v.sphere?.length === 4);
}
async function content(uri, base, w, world, vols, ctx) {
  if (isUrl(uri)) return warn('REMOTE', w, uri);
  const file = path.resolve(base, decodeURIComponent(uri.split(/[?#]/)[0]));
  let b; try { b = read(file); } catch { return err('CONTENT_MISSING', w, uri); }
  counts.contents++; const kind = T.sniff(b, uri), loadUri = (u) => fs.readFileSync(path.resolve(path.dirname(file), decodeURIComponent(u)));
  if (kind === 'tileset') return tileset(file, b, world, ctx, w);
  const isG = kind === 'glb' || kind === 'gltf'; let glbs = [];
  if (isG) glbs = [b]; else if (['b3dm', 'i3dm', 'pnts', 'cmpt'].includes(kind)) { const r = T.readLegacy(b); r.errors.forEach((e) => err('CONTENT_INVALID', w + ' ' + uri, e)); glbs = r.glbs; for (const k of r.inner) counts[k] = (counts[k] ?? 0) + 1; for (const u of r.uris) if (!isUrl(u)) { try { loadUri(u); } catch { err('CONTENT_MISSING', w, 'i3dm glTF ' + u); } } if (kind === 'cmpt') counts.cmpt--, counts.cmpt++; }
  else if (kind === 'geojson') { counts.geojson++; return; }
  else return (kind === 'badjson' || b.length < 4 ? err : warn)('CONTENT_TYPE_UNKNOWN', w, `${uri}: ${kind}`);
  if (kind === 'glb') counts.glb++; if (kind === 'gltf') counts.gltf++;
  for (const g of glbs) {
    const gl = T.magic(g) === 'glTF'; if (gl && T.readGlb(g).version === 1) { warn('GLTF1', w, uri + ' embeds glTF 1.0'); continue; }
    if (!gl && !isG && g[0] !== 0x7b) { err('CONTENT_INVALID', w, uri + ': no glTF inside'); continue; }
    const bytes = gl ? g.subarray(0, Math.min(g.length, g.readUInt32LE(8))) : g;
    if (!a['no-gltf']) try { const r = await checkGltf(bytes, uri, loadUri); for (const e of r.errors.slice(0, 5)) err('GLTF_' + e.code, `${w} ${uri}${e.pointer ?? ''}`, e.message); for (const e of r.warnings.slice(0, 3)) warn('GLTF_' + e.code, `${w} ${uri}${e.pointer ?? ''}`, e.message); counts.triangles += r.info?.totalTriangleCount ?? 0; counts.vertices += r.info?.totalVertexCount ?? 0; for (const x of r.info?.extensionsUsed ?? []) counts.extensions[x] = (counts.extensions[x] ?? 0) + 1; } catch (e) { err('GLTF', w, `${uri}: ${e}`); continue; }
    if (isG) try {
      const { json, bin } = gl ? T.readGlb(bytes) : { json: JSON.parse(bytes.toString('utf8')) }; const P = T.gltfPositions(json, bin, loadUri); if (!P) continue;
      const rtc = P.rtc ? T.xf(T.YUP, P.rtc) : null;
      for (const [name, vol] of vols) { let worst = 0, n = 0; for (const p0 of P.positions) { const p = rtc ? p0.map((x, i) => x + rtc[i]) : p0, d = T.outside(vol, world, T.xf(world, p)); if (d > worst) worst = d; if (d > tol) n++; } if (n) warn('GEOMETRY_OUTSIDE_VOLUME', `${w} ${uri}`, `${n}/${P.positions.length} vertices outside ${name} by up to ${worst.toFixed(3)} m`); }
    } catch (e) { warn('GEOMETRY', w, `${uri}: ${e}`); }
  }
}
const fill = (t, l, x, y, z) => t.replace(/\{level\}/g, l).replace(/\{x\}/g, x).replace(/\{y\}/g, y).replace(/\{z\}/g, z);
function childVol(v, oct, l, x, y, z) {
  const n = 2 ** l;
  if (v.box) { const b = v.box, r = b.slice(), f = [(2 * x + 1) / n - 1, (2 * y + 1) / n - 1, oct ? (2 * z + 1) / n - 1 : 0], s = [1 / n, 1 / n, oct ? 1 / n : 1]; for (let i = 0; i < 3; i++) r[i] = b[i] + f[0] * b[3 + i] + f[1] * b[6 + i] + f[2] * b[9 + i]; for (let k = 0; k < 3; k++) for (let i = 0; i < 3; i++) r[3 + 3 * k + i] = b[3 + 3 * k + i] * s[k]; return { box: r }; }
  if (v.region) { const [w, s, e, t, lo, hi] = v.region, W = (e < w ? e + 2 * Math.PI - w : e - w) / n, H = (t - s) / n, D = oct ? (hi - lo) / n : hi - lo, q = (u) => (u > Math.PI ? u - 2 * Math.PI : u); return { region: [q(w + x * W), s + y * H, q(w + (x + 1) * W), s + (y + 1) * H, oct ? lo + z * D : lo, oct ? lo + (z + 1) * D : hi] }; }
  return null;
}
async function implicit(tile, base, w, world, ctx) {
  const I = tile.implicitTiling, oct = I.subdivisionScheme === 'OCTREE', N = oct ? 8 : 4, L = I.subtreeLevels, vars = oct ? ['level', 'x', 'y', 'z'] : ['level', 'x', 'y'];
  if (tile.children) err('TILE_IMPLICIT_ROOT_INVALID', w, 'implicit root has children'); if (tile.metadata) err('TILE_IMPLICIT_ROOT_INVALID', w, 'implicit root has metadata');
  const cs = tile.contents ?? (tile.content ? [tile.content] : []); if (cs.some((c) => c.boundingVolume)) err('TILE_IMPLICIT_ROOT_INVALID', w, 'template content has boundingVolume');
  if (tile.boundingVolume.sphere && !tile.boundingVolume.box && !tile.boundingVolume.region) err('IMPLICIT_TILING_ERROR', w, 'implicit root needs box or region');
  for (const t of [I.subtrees.uri, ...cs.map((c) => c.uri)]) { for (const v of [...t.matchAll(/\{([^}]*)\}/g)].map((m) => m[1])) if (!vars.includes(v)) err('TEMPLATE_URI_INVALID_VARIABLE_NAME', w, t); for (const v of vars) if (!t.includes(`{${v}}`)) warn('TEMPLATE_URI_MISSING_VARIABLE_NAME', w, `${t} lacks {${v}}`); }
  const start = (l) => (N ** l - 1) / (N - 1), queue = [[0, 0, 0, 0]], used = new Set();
  while (queue.length) {
    const [l0, x0, y0, z0] = queue.shift(), u = fill(I.subtrees.uri, l0, x0, y0, z0), f = path.resolve(base, u), sw = `${w} subtree ${u}`; let b;
    try { b = read(f); } catch { err('SUBTREE_MISSING', sw, f); continue; }
    counts.subtrees++; used.add(f); const s = T.readSubtree(b, (q) => read(path.resolve(path.dirname(f), q))); s.errors.forEach((e) => err('SUBTREE_INVALID', sw, e)); if (!s.json || !schema(vSubtree, s.json, sw)) continue;
    const nT = start(L), ta = s.avail(s.json.tileAvailability, nT, 'tileAvailability'), ca = (s.json.contentAvailability ?? []).map((c, i) => s.avail(c, nT, 'contentAvailability ' + i)), cc = s.avail(s.json.childSubtreeAvailability, N ** L, 'childSubtreeAvailability'); s.errors.splice(0).forEach((e) => err('SUBTREE_INVALID', sw, e));
    if (ta.count === 0) err('SUBTREE_AVAILABILITY_INCONSISTENT', sw, 'no tile is available'); if (ca.length > cs.length) err('SUBTREE_AVAILABILITY_INCONSISTENT', sw, `${ca.length} contentAvailability for ${cs.length} contents`);
    const dec = (m, l) => { let x = 0, y = 0, z = 0; const d = oct ? 3 : 2; for (let i = 0; i < l; i++) { x |= (m >> (d * i) & 1) << i; y |= (m >> (d * i + 1) & 1) << i; if (oct) z |= (m >> (d * i + 2) & 1) << i; } return [x, y, z]; };
    for (let l = 0; l < L; l++) for (let m = 0; m < N ** l; m++) {
      const i = start(l) + m, on = ta.get(i); if (on && l && !ta.get(start(l - 1) + (m / N | 0))) err('SUBTREE_AVAILABILITY_INCONSISTENT', sw, `tile ${i} available without its parent`);
      if (on && l0 + l >= (I.availableLevels ?? I.maximumLevel + 1)) err('SUBTREE_AVAILABILITY_INCONSISTENT', sw, `tile at level ${l0 + l} beyond availableLevels`);
      for (let c = 0; c < ca.length; c++) if (ca[c].get(i)) {
        if (!on) { err('SUBTREE_AVAILABILITY_INCONSISTENT', sw, `content ${i} available but the tile is not`); continue; }
        const [dx, dy, dz] = dec(m, l), g = 2 ** l, [X, Y, Z] = [x0 * g + dx, y0 * g + dy, z0 * g + dz], v = childVol(tile.boundingVolume, oct, l0 + l, X, Y, Z);
        if (!a['no-content'] && cs[c]) await content(fill(cs[c].uri, l0 + l, X, Y, Z), base, `${w} L${l0 + l}/${X}/${Y}${oct ? '/' + Z : ''}`, world, v ? [['the implicit tile volume', v]] : [], ctx);
      }
      if (on) { counts.implicitTiles++; counts.tiles++; counts.maxDepth = Math.max(counts.maxDepth, ctx.depth + l0 + l); }
    }
    for (let m = 0; m < N ** L; m++) if (cc.get(m)) { if (!ta.get(start(L - 1) + (m / N | 0))) err('SUBTREE_AVAILABILITY_INCONSISTENT', sw, `child subtree ${m} below an unavailable tile`); const [dx, dy, dz] = dec(m, L), g = 2 ** L; if (l0 + L < (I.availableLevels ?? 99) && counts.subtrees + queue.length < 100000) queue.push([l0 + L, x0 * g + dx, y0 * g + dy, z0 * g + dz]); else err('SUBTREE_AVAILABILITY_INCONSISTENT', sw, `child subtree beyond availableLevels`); }
  }
}
async function tileset(file, bytes, world0, ctx, from) {
  const w0 = (from ? from + ' -> ' : '') + path.basename(file); if (ctx.stack.includes(file)) return err('TILESET_CYCLE', w0, 'external tilesets form a cycle');
  let j; try { j = JSON.parse(bytes.toString('utf8').replace(/^\uFEFF/, '')); } catch (e) { return err('JSON', w0, e.message); }
  if (bytes[0] === 0xef && bytes[1] === 0xbb) err('JSON', w0, 'UTF-8 byte order mark');
  counts.tilesets++; const okS = schema(vTileset, j, w0); const base = path.dirname(file); const used = new Set(Array.isArray(j.extensionsUsed) ? j.extensionsUsed : []), req = new Set(Array.isArray(j.extensionsRequired) ? j.extensionsRequired : []), found = ext(j);
  const v = j.asset?.version; if (typeof v === 'string' && !['0.0', '1.0', '1.1'].includes(v)) warn('ASSET_VERSION_UNKNOWN', w0, v);
  for (const e of req) if (!used.has(e)) err('EXTENSION_REQUIRED_BUT_NOT_USED', w0, e); for (const e of found) { if (!used.has(e)) err('EXTENSION_FOUND_BUT_NOT_USED', w0, e); if (!KNOWN.has(e)) warn('EXTENSION_NOT_SUPPORTED', w0, e); } for (const e of used) { counts.extensions[e] = (counts.extensions[e] ?? 0) + 1; if (!found.has(e) && e !== '3DTILES_content_gltf') warn('EXTENSION_USED_BUT_NOT_FOUND', w0, e); }
  for (const [k, p] of Object.entries(j.properties ?? {})) if (p?.minimum > p?.maximum) err('PROPERTIES_MINIMUM_LARGER_THAN_MAXIMUM', w0, k);
  if (typeof j.schemaUri === 'string' && j.schema) err('SCHEMA', w0, 'both schema and schemaUri'); if (typeof j.schemaUri === 'string' && !isUrl(j.schemaUri) && !fs.existsSync(path.resolve(base, j.schemaUri))) err('SCHEMA_URI_MISSING', w0, j.schemaUri);
  let sch = j.schema; if (typeof j.schemaUri === 'string' && !isUrl(j.schemaUri)) try { sch = JSON.parse(fs.readFileSync(path.resolve(base, j.schemaUri))); schema(ajv.getSchema('file:///Schema/schema.schema.json'), sch, w0 + ' ' + j.schemaUri); } catch { /* reported above */ }
  const entity = (m, where) => { if (!m?.class) return; if (!sch) return err('METADATA_WITHOUT_SCHEMA', where, m.class); const c = sch.classes?.[m.class]; if (!c) return err('METADATA_CLASS', where, m.class); for (const k of Object.keys(m.properties ?? {})) if (!c.properties?.[k]) err('METADATA_PROPERTY', where, k); for (const [k, q] of Object.entries(c.properties ?? {})) if (q.required && m.properties?.[k] === undefined) err('METADATA_PROPERTY', where, 'required ' + k); };
  entity(j.metadata, w0 + ' metadata'); (Array.isArray(j.groups) ? j.groups : []).forEach((g, i) => entity(g, `${w0} groups/${i}`));
  if (j.statistics?.classes) { if (!sch) err('METADATA_WITHOUT_SCHEMA', w0, 'statistics'); else for (const [k, c] of Object.entries(j.statistics.classes)) { if (!sch.classes?.[k]) err('METADATA_CLASS', w0, 'statistics ' + k); else for (const q of Object.keys(c.properties ?? {})) if (!sch.classes[k].properties?.[q]) err('METADATA_PROPERTY', w0, `statistics ${k}.${q}`); } }
  if (v === '1.0' && !used.has('3DTILES_content_gltf') && /"ur[il]"\s*:\s*"[^"]*\.gl(b|tf)"/.test(bytes.toString('utf8'))) err('EXTENSION_FOUND_BUT_NOT_USED', w0, '1.0 tileset with glTF content without 3DTILES_content_gltf');
  if (!okS || !j.root || typeof j.root !== 'object') return; if (j.root.refine === undefined) err('TILE_REFINE_MISSING_IN_ROOT', w0, 'root.refine is required');
  const gE = j.geometricError; if (typeof gE === 'number' && j.root.geometricError > gE) warn('TILE_GEOMETRIC_ERRORS_INCONSISTENT', w0, `root ${j.root.geometricError} > tileset ${gE}`);
  const groups = j.groups?.length ?? 0;
  const visit = async (t, w, world, depth, parent) => {
    if (++counts.tiles > maxTiles) { if (counts.tiles === maxTiles + 1) warn('LIMIT', w, 'stopped at --max-tiles'); return; } counts.maxDepth = Math.max(counts.maxDepth, depth);
    if (t.refine && !['ADD', 'REPLACE'].includes(t.refine)) (/^(add|replace)$/i.test(t.refine) ? warn : err)('TILE_REFINE_WRONG_CASE', w, t.refine);
    const m = t.transform ?? T.ident(); if (m.length === 16) { if (m[3] || m[7] || m[11] || Math.abs(m[15] - 1) > 1e-9) err('TRANSFORM_INVALID', w, 'not affine column-major (bottom row must be 0,0,0,1): row-major matrix?'); const det = m[0] * (m[5] * m[10] - m[9] * m[6]) - m[4] * (m[1] * m[10] - m[9] * m[2]) + m[8] * (m[1] * m[6] - m[5] * m[2]); if (Math.abs(det) < 1e-18) warn('TRANSFORM_INVALID', w, 'singular'); }
    const mw = T.mul(world, m); const s2 = t.boundingVolume?.extensions; if (!volOk(t.boundingVolume, w) && !s2) err('BOUNDING_VOLUME_INVALID', w, 'needs box, region or sphere'); if (t.viewerRequestVolume) volOk(t.viewerRequestVolume, w + ' viewerRequestVolume');
    if (t.content && t.contents) err('ONE_OF', w, 'content and contents'); const cs = t.contents ?? (t.content ? [t.content] : []);
    if (parent && t.geometricError > parent.geometricError) warn('TILE_GEOMETRIC_ERRORS_INCONSISTENT', w, `${t.geometricError} > parent ${parent.geometricError}`);
    if (parent && !s2) { const d = Math.max(0, ...T.corners(t.boundingVolume, mw).map((p) => T.outside(parent.boundingVolume, world, p))); const size = Math.max(1e-9, ...T.corners(parent.boundingVolume, world).map((p, _, q) => Math.hypot(...p.map((x, i) => x - q[0][i])))); if (d > tol && d > 1e-3 * size) warn('BOUNDING_VOLUMES_INCONSISTENT', w, `exceeds the parent's volume by ${d.toFixed(3)} m`); }
    for (const c of cs) { if (c.group !== undefined && c.group >= groups) err('GROUP', w, `content.group ${c.group} of ${groups}`); if (c.boundingVolume && !t.implicitTiling) { volOk(c.boundingVolume, w + ' content'); const d = Math.max(0, ...T.corners(c.boundingVolume, mw).map((p) => T.outside(t.boundingVolume, mw, p))); if (d > tol) err('BOUNDING_VOLUMES_INCONSISTENT', w, `content volume exceeds the tile's by ${d.toFixed(3)} m`); } entity(c.metadata, w + ' content'); }
    entity(t.metadata, w);
    const I = t.implicitTiling ?? t.extensions?.['3DTILES_implicit_tiling']; if (I) counts.tiles--;
    if (I && t.boundingVolume) { if (!['QUADTREE', 'OCTREE'].includes(I.subdivisionScheme)) err('IMPLICIT_TILING_ERROR', w, 'subdivisionScheme ' + I.subdivisionScheme); else if (I.subtreeLevels > 0 && I.subtreeLevels <= 12 && (I.availableLevels ?? I.maximumLevel) >= 0 && I.subtrees?.uri) await implicit({ ...t, implicitTiling: I }, base, w, mw, { stack: [...ctx.stack, file], depth }); else err('IMPLICIT_TILING_ERROR', w, 'subtreeLevels/availableLevels/subtrees'); }
    else if (!a['no-content']) for (const c of cs) if (c.uri ?? c.url) { const vols = []; if (volOk(c.boundingVolume)) vols.push(['content.boundingVolume', c.boundingVolume]); else if (volOk(t.boundingVolume) && !s2) vols.push(['the tile volume', t.boundingVolume]); await content(c.uri ?? c.url, base, w, mw, vols, { stack: [...ctx.stack, file], depth: depth + 1 }); }
    let i = 0; for (const c of t.children ?? []) await visit(c, `${w}/children/${i++}`, mw, depth + 1, t);
  };
  await visit(j.root, w0 + '#/root', world0, ctx.depth, null);
}
if (!a._[0] && !a.subtree) { console.error('usage: validate.mjs DIR|tileset.json'); process.exit(2); }
const t0 = Date.now(); let target = '';
if (a.subtree) { target = path.resolve(a.subtree); const I = JSON.parse(fs.readFileSync(a.implicit)); a['no-content'] = true; const N = I.subdivisionScheme === 'OCTREE' ? 8 : 4, b = fs.readFileSync(target), s = T.readSubtree(b, (q) => fs.readFileSync(path.resolve(path.dirname(target), q))); s.errors.forEach((e) => err('SUBTREE_INVALID', a.subtree, e)); if (s.json && schema(vSubtree, s.json, a.subtree)) { const n = (N ** I.subtreeLevels - 1) / (N - 1), ta = s.avail(s.json.tileAvailability, n, 'tile'), st = (l) => (N ** l - 1) / (N - 1), ca = (s.json.contentAvailability ?? []).map((c) => s.avail(c, n, 'content')), cc = s.avail(s.json.childSubtreeAvailability, N ** I.subtreeLevels, 'child'); s.errors.splice(0).forEach((e) => err('SUBTREE_INVALID', a.subtree, e)); if (!ta.count) err('SUBTREE_AVAILABILITY_INCONSISTENT', a.subtree, 'no tile'); for (let l = 1; l < I.subtreeLevels; l++) for (let m = 0; m < N ** l; m++) if (ta.get(st(l) + m) && !ta.get(st(l - 1) + (m / N | 0))) err('SUBTREE_AVAILABILITY_INCONSISTENT', a.subtree, 'orphan tile'); for (let i = 0; i < n; i++) if (ca.some((c) => c.get(i)) && !ta.get(i)) err('SUBTREE_AVAILABILITY_INCONSISTENT', a.subtree, 'orphan content'); for (let m = 0; m < N ** I.subtreeLevels; m++) if (cc.get(m) && !ta.get(st(I.subtreeLevels - 1) + (m / N | 0))) err('SUBTREE_AVAILABILITY_INCONSISTENT', a.subtree, 'orphan child subtree'); } }
else { target = path.resolve(a._[0]); if (fs.existsSync(target) && fs.statSync(target).isDirectory()) target = path.join(target, 'tileset.json'); let b; try { b = read(target); } catch { console.log(JSON.stringify({ ok: false, errors: 1, error: 'cannot read ' + target })); process.exit(1); } await tileset(target, b, T.ident(), { stack: [], depth: 0 }, ''); }
const E = issues.filter((x) => x.sev === 'error'), W = issues.filter((x) => x.sev === 'warning'), by = (l) => l.reduce((o, x) => (o[x.type] = (o[x.type] ?? 0) + 1, o), {});
if (!a.quiet) for (const x of [...E.slice(0, 40), ...W.slice(0, 20)]) console.error(`${x.sev.toUpperCase()} ${x.type} ${x.where}: ${x.msg}`);
console.log(JSON.stringify({ ok: !E.length, tileset: target, errors: E.length, warnings: W.length, errorTypes: by(E), warningTypes: by(W), ...counts, ms: Date.now() - t0 }));
process.exit(E.length ? 1 : 0);
