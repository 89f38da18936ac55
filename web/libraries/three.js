// The parts of three.js that our view uses: bundled by deploy/build-pages.sh, so that a page loads only these.
export {
  BoxGeometry, BufferAttribute, BufferGeometry, Color, ColorManagement, DataTexture, DoubleSide, EdgesGeometry, GLSL3,
  Group, IntType, LineBasicMaterial, LineSegments, LinearSRGBColorSpace, Matrix3, Matrix4, Mesh, MeshBasicMaterial,
  PerspectiveCamera, PlaneGeometry, Points, Quaternion, Raycaster, Scene, ShaderMaterial, Sphere, Vector2, Vector3,
  WebGLRenderer,
} from "three";
