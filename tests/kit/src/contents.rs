//! Writes contents of 3D Tiles 1.0.

/// Returns JSON that spaces pad to a multiple of eight bytes.
pub fn padded(text: &str) -> Vec<u8> {
    let mut bytes = text.as_bytes().to_vec();
    bytes.resize(bytes.len().next_multiple_of(8), b' ');
    bytes
}

/// Returns a b3dm with a feature table and a glb.
pub fn b3dm_bytes(table: &str, glb: &[u8]) -> Vec<u8> {
    b3dm_with_batches(table, "", glb)
}

/// Returns a b3dm with a feature table, a batch table in JSON and a glb.
pub fn b3dm_with_batches(table: &str, batches: &str, glb: &[u8]) -> Vec<u8> {
    let (table, batches) = (padded(table), padded(batches));
    let mut out = b"b3dm".to_vec();
    for word in [1, 28 + table.len() + batches.len() + glb.len(), table.len(), 0, batches.len(), 0] {
        out.extend((word as u32).to_le_bytes());
    }
    [out, table, batches, glb.to_vec()].concat()
}

/// Returns a pnts with a feature table and its binary part.
pub fn pnts_bytes(table: &str, points: &[u8]) -> Vec<u8> {
    pnts_with_batches(table, points, "")
}

/// Returns a pnts with a feature table, its binary part and a batch table in JSON.
pub fn pnts_with_batches(table: &str, points: &[u8], batches: &str) -> Vec<u8> {
    let (table, batches) = (padded(table), padded(batches));
    let mut out = b"pnts".to_vec();
    let length = 28 + table.len() + points.len() + batches.len();
    for word in [1, length, table.len(), points.len(), batches.len(), 0] {
        out.extend((word as u32).to_le_bytes());
    }
    [out, table, points.to_vec(), batches].concat()
}

/// Returns a composite of tiles.
pub fn cmpt_bytes(tiles: &[Vec<u8>]) -> Vec<u8> {
    let length = 16 + tiles.iter().map(Vec::len).sum::<usize>();
    let mut bytes = b"cmpt".to_vec();
    bytes.extend([1, length as u32, tiles.len() as u32].iter().flat_map(|word| word.to_le_bytes()));
    bytes.extend(tiles.concat());
    bytes
}

/// A glTF 1.0 with most of what an upgrade converts. Its only buffer has a URI, and the name of the body of a binary glTF.
pub const GLTF_1: &str = r#"{"asset":{"version":"1.0","profile":{"api":"WebGL","version":"1.0.3"}},"extensionsUsed":["KHR_binary_glTF","KHR_materials_common","CESIUM_RTC","WEB3D_quantized_attributes"],"extensions":{"CESIUM_RTC":{"center":[1,2,3]},"KHR_materials_common":{"lights":{"l":{"type":"ambient"}}}},"scene":"s","scenes":{"s":{"nodes":["n","m"]}},"nodes":{"n":{"children":["o"],"meshes":["a","b"],"translation":[1,2,3],"rotation":[0,0,0,1],"scale":[1,2,1]},"m":{"matrix":[1,0,0,0,0,1,0,0,0,0,1,0,0,0,0,1]},"o":{"meshes":["a"]}},"meshes":{"a":{"primitives":[{"attributes":{"POSITION":"p","TEXCOORD":"t","COLOR":"c","BATCHID":"i"},"indices":"i","material":"webgl","mode":4}]},"b":{"primitives":[{"attributes":{"POSITION":"q"},"material":"common"}]}},"materials":{"webgl":{"technique":"w","values":{"diffuse":"x","transparency":0.5}},"common":{"extensions":{"KHR_materials_common":{"technique":"PHONG","doubleSided":true,"transparent":true,"values":{"diffuse":[1,0.5,0,1],"emission":"y","specular":[1,1,1,1],"transparency":0.5}}}}},"techniques":{"w":{"parameters":{"diffuse":{"semantic":"_3DTILESDIFFUSE","type":35678},"e":{"type":35666,"value":[1,0,0,1]}},"uniforms":{"u_diffuse":"diffuse","u_e":"e"},"states":{"enable":[2929,3042]}}},"textures":{"x":{"sampler":"r","source":"f"},"y":{"source":"g"}},"samplers":{"r":{"magFilter":9728,"minFilter":9986,"wrapS":33071,"wrapT":33648}},"images":{"f":{"uri":"a.png"},"g":{"uri":"b.png"}},"accessors":{"p":{"bufferView":"v","byteOffset":0,"byteStride":24,"componentType":5126,"count":3,"type":"VEC3"},"t":{"bufferView":"v","byteOffset":12,"byteStride":24,"componentType":5126,"count":3,"type":"VEC2"},"c":{"bufferView":"v","byteOffset":20,"byteStride":24,"componentType":5121,"count":3,"type":"VEC4"},"q":{"bufferView":"w","byteStride":0,"componentType":5123,"count":3,"type":"VEC3","extensions":{"WEB3D_quantized_attributes":{"decodeMatrix":[0.1,0,0,0,0,0.1,0,0,0,0,0.1,0,1,2,3,1],"decodedMin":[0,0,0],"decodedMax":[9,9,9]}}},"i":{"bufferView":"w","componentType":5121,"count":3,"type":"SCALAR"}},"bufferViews":{"v":{"buffer":"binary_glTF","byteLength":72},"w":{"buffer":"binary_glTF","byteOffset":72}},"buffers":{"binary_glTF":{"byteLength":92,"type":"arraybuffer","uri":"data:application/octet-stream;base64,AAAAAAAAAAAAAAAAAAAAAAAAAAD/AAD/AACAPwAAAAAAAAAAAACAPwAAAAAA/wD/AAAAAAAAgD8AAAAAAAAAAAAAgD8AAP//AAECAAAAZAAAAAAAAADIAAAAAAA="}}}"#;

/// Returns a binary glTF of version 1.
pub fn glb_1(json: &str, body: &[u8]) -> Vec<u8> {
    let mut glb = b"glTF".to_vec();
    for word in [1, 20 + json.len() + body.len(), json.len(), 0] {
        glb.extend((word as u32).to_le_bytes());
    }
    [glb, json.as_bytes().to_vec(), body.to_vec()].concat()
}
