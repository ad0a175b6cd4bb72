// Draws the three-dimensional view of the page (three.js): the surface where a hand first meets a force, a
// slice with cones for forces, bodies, arrays of actuators, the workspace and the probe.
import {
  AmbientLight, BoxGeometry, BufferAttribute, BufferGeometry, Color, ConeGeometry, CylinderGeometry, DirectionalLight,
  DoubleSide, EdgesGeometry, Group, InstancedMesh, LineBasicMaterial, LineSegments, Matrix4, Mesh, MeshBasicMaterial,
  MeshLambertMaterial, PerspectiveCamera, Plane, PlaneGeometry, Quaternion, Scene,
  SphereGeometry, SRGBColorSpace, Vector3, WebGLRenderer, type Object3D,
} from "three";
import { type Directions } from "./axes";
import { rowOf, TABLE } from "./colour";
import type { Away, Cut, Head, Mesh as Surface, Ray, Shown, Triple } from "./engine";

const ACCENT = 0xe8590c;
const CONES = 30;
const UP = new Vector3(0, 1, 0);
export const PIN_ARRAYS = /dot|pin|graphiti|braille/i;

interface Label {
  element: HTMLSpanElement;
  position: () => Vector3 | null;
}

export class View {
  readonly isFlat = false;
  readonly camera = new PerspectiveCamera(32, 1, 0.01, 60);
  isOpen = true;
  triangles = 0;
  cones = 0;
  bodies = 0;
  private readonly renderer: WebGLRenderer;
  private readonly scene = new Scene();
  private readonly root = new Group();
  private parts: Group[] = [];
  private readonly slice = new Group();
  private readonly probe = new Group();
  private readonly clip = new Plane(new Vector3(0, 1, 0), 0);
  private readonly light = new DirectionalLight(0xffffff, 2.6);
  private head: Head | null = null;
  private directions: Directions | null = null;
  private low = new Vector3();
  private side = new Vector3(1, 1, 1);
  private unit = 1;
  private top = 1;
  private limit = Infinity;
  private turn = { across: 0, height: 0, distance: 4 };
  private labels: Label[] = [];
  private isDue = false;
  private array: InstancedMesh | null = null;
  private cutAt: { axis: number; at: number } | null = null;
  private readonly strongest = new Int32Array((CONES + 1) ** 2);
  private readonly sheet = new MeshBasicMaterial({ transparent: true, side: DoubleSide, depthWrite: false, vertexColors: true });
  private readonly rim = line(0x0f172a);
  private readonly ink = new MeshBasicMaterial({ depthTest: false, transparent: true });
  private readonly white = new MeshLambertMaterial({ color: 0xffffff, emissive: 0x333333 });
  private readonly lit = new MeshLambertMaterial({ vertexColors: true, side: DoubleSide, clippingPlanes: [this.clip] });
  onDrawn: (() => void) | null = null;

  constructor(private readonly canvas: HTMLCanvasElement, private readonly overlay: HTMLElement, context: WebGL2RenderingContext) {
    this.renderer = new WebGLRenderer({ canvas, context, alpha: true });
    this.renderer.localClippingEnabled = true;
    this.scene.add(new AmbientLight(0xffffff, 0.9), this.light, this.root);
    new ResizeObserver(() => this.resize()).observe(canvas);
    this.recolour();
    this.resize();
  }

  /** Draw lines with the colours of the page, which have changed. */
  recolour(): void {
    const isDark = getComputedStyle(document.documentElement).colorScheme.includes("dark");
    for (const { color } of [this.rim, this.ink]) color.setHex(isDark ? 0xe6e9ef : 0x0f172a);
    this.due();
  }

  /** Geometries, textures and programs that the graphics card stores. */
  get graphicsObjects(): number {
    const { memory, programs } = this.renderer.info;
    return memory.geometries + memory.textures + (programs?.length ?? 0);
  }

  private resize(): void {
    const { clientWidth: width, clientHeight: height } = this.canvas;
    if (!width || !height) return;
    this.renderer.setPixelRatio(Math.min(devicePixelRatio, 2));
    this.renderer.setSize(width, height, false);
    this.camera.aspect = width / height;
    this.camera.updateProjectionMatrix();
    this.due();
  }

  due(): void {
    if (this.isDue) return;
    this.isDue = true;
    requestAnimationFrame(() => {
      this.isDue = false;
      this.draw();
    });
  }

  /** Start with a file: its box, and the camera before it. */
  start(head: Head, directions: Directions, names: { box: string; axes: string[] }): void {
    for (const child of [...this.root.children]) dispose(child), this.root.remove(child);
    this.overlay.replaceChildren();
    this.labels = [];
    this.parts = [];
    this.array = null;
    this.head = head;
    this.directions = directions;
    this.scale(head.peak);
    this.low.fromArray(head.origin.map((o, n) => o - head.spacing[n]! / 2));
    this.side.fromArray(head.shape.map((count, n) => count * head.spacing[n]!));
    this.unit = 2 / this.side.length();
    this.root.scale.setScalar(this.unit);
    this.root.position.copy(this.low).addScaledVector(this.side, 0.5).multiplyScalar(-this.unit);
    this.root.updateMatrixWorld(true);
    const edges = new LineSegments(new EdgesGeometry(new BoxGeometry(...this.side.toArray())), line(0x8a94a6));
    edges.position.copy(this.low).addScaledVector(this.side, 0.5);
    this.slice.clear();
    this.slice.userData.key = "";
    this.probe.clear();
    this.root.add(edges, this.slice, this.probe);
    this.makeProbe();
    for (let axis = 0; axis < (head.type === 2 ? 2 : 3); axis++) this.label(names.axes[axis]!, () => this.edge(axis));
    edges.visible = head.type === 1;
    this.label(names.box, () => this.corner());
    this.reset();
  }

  /** What the brightest colour stands for, and the fraction of it above which it is red. */
  scale(top: number, limit = Infinity): void {
    this.top = top;
    this.limit = limit;
  }

  reset(): void {
    const isFront = this.directions?.names.some((word) => word === "forward"); // as a camera saw it
    const isPinned = this.isPins();
    this.turn = this.head?.type === 2 ? { across: 0.3, height: isPinned ? 0.6 : 0.25, distance: isPinned ? 3.9 : 5 } : { across: isFront ? 0.5 : 0.9, height: isFront ? 0.3 : 0.55, distance: 3.9 };
    this.due();
  }

  /** From where the camera looks. */
  seenFrom(): string {
    const degrees = Math.round((this.turn.across * 180) / Math.PI / 5) * 5;
    const side = ((((degrees + 180) % 360) + 360) % 360) - 180;
    const around = side === 0 ? "the front" : side === -180 ? "behind" : `${Math.abs(side)} degrees to the ${side > 0 ? "right" : "left"} of the front`;
    const height = Math.round((this.turn.height * 180) / Math.PI);
    return `Seen from ${around}, ${Math.abs(height)} degrees ${height < 0 ? "below" : "above"}.`;
  }

  /** Turn the camera, radians, and come nearer by a factor. */
  orbit(across: number, height: number, nearer = 1): void {
    this.turn.across += across;
    this.turn.height = Math.min(Math.max(this.turn.height + height, -1.5), 1.5);
    this.turn.distance = Math.min(Math.max(this.turn.distance / nearer, 0.6), 20);
    this.due();
  }

  private vector(direction: Triple): Vector3 {
    return new Vector3(...direction);
  }

  private placeCamera(): void {
    if (!this.directions) return;
    const { across, height } = this.turn;
    const distance = this.turn.distance * Math.max(1, 1.15 / this.camera.aspect);
    const up = this.vector(this.directions.up);
    this.camera.up.copy(up);
    this.camera.position
      .copy(this.vector(this.directions.right)).multiplyScalar(Math.sin(across) * Math.cos(height))
      .addScaledVector(this.vector(this.directions.towards), Math.cos(across) * Math.cos(height))
      .addScaledVector(up, Math.sin(height))
      .multiplyScalar(distance);
    this.camera.lookAt(0, 0, 0);
    this.camera.updateMatrixWorld();
    const right = new Vector3().crossVectors(up, this.camera.position).normalize();
    this.light.position.copy(this.camera.position).addScaledVector(right, -1.3 * distance).addScaledVector(up, 0.7 * distance);
  }

  // -- what a frame brings ------------------------------------------------------------------------------------------

  show(shown: Shown): void {
    if (!this.head) return;
    this.bodies = shown.parts;
    while (this.parts.length < shown.parts && !shown.grid) {
      const group = new Group();
      group.matrixAutoUpdate = false;
      this.parts.push(group);
      this.root.add(group);
    }
    for (const mesh of shown.meshes) this.surface(mesh);
    this.parts.forEach((group, n) => {
      const p = shown.poses.subarray(12 * n, 12 * n + 12);
      group.matrix.set(p[0]!, p[1]!, p[2]!, p[9]!, p[3]!, p[4]!, p[5]!, p[10]!, p[6]!, p[7]!, p[8]!, p[11]!, 0, 0, 0, 1);
      group.matrixWorldNeedsUpdate = true;
    });
    if (shown.grid) this.actuators(shown.grid);
    if (shown.cut) this.cut(shown.cut);
    this.due();
  }

  private surface(mesh: Surface): void {
    const group = this.parts[mesh.part];
    if (!group) return;
    for (const child of [...group.children]) dispose(child, false), group.remove(child);
    const count = mesh.vertex.length / 7;
    if (!count) return;
    const [positions, normals, colours] = [new Float32Array(3 * count), new Float32Array(3 * count), new Float32Array(3 * count)];
    for (let i = 0; i < count; i++) {
      for (let k = 0; k < 3; k++) {
        positions[3 * i + k] = mesh.vertex[7 * i + k]!;
        normals[3 * i + k] = mesh.vertex[7 * i + 3 + k]!;
      }
      const at = rowOf(mesh.vertex[7 * i + 6]! / this.top, this.limit);
      for (let k = 0; k < 3; k++) colours[3 * i + k] = LINEAR[at + k]!;
    }
    const geometry = new BufferGeometry();
    geometry.setAttribute("position", new BufferAttribute(positions, 3));
    geometry.setAttribute("normal", new BufferAttribute(normals, 3));
    geometry.setAttribute("color", new BufferAttribute(colours, 3));
    geometry.setIndex(new BufferAttribute(mesh.index, 1));
    group.add(new Mesh(geometry, this.lit));
    this.triangles = this.parts.reduce((sum, p) => sum + p.children.reduce((n, c) => n + triangles(c), 0), 0);
  }

  private isPins(): boolean {
    return PIN_ARRAYS.test(this.overlay.dataset.device ?? "");
  }

  private actuators(forces: Float32Array): void {
    const head = this.head!;
    const [nx, ny] = head.shape;
    const isPins = this.isPins();
    const pitch = Math.min(head.spacing[0], head.spacing[1]);
    const towards = this.vector(this.directions!.towards);
    if (!this.array) {
      const geometry = new CylinderGeometry(isPins ? 0.3 : 0.42, isPins ? 0.3 : 0.42, 1, 20);
      this.array = new InstancedMesh(geometry, new MeshLambertMaterial(), nx * ny);
      const back = isPins ? new Mesh(new BoxGeometry(1.06, 1.06, 0.02), new MeshLambertMaterial({ color: 0xaab2c0 })) : garment();
      const turned = this.vector(this.directions!.up).y;
      back.scale.set(this.side.x, turned * this.side.y, this.side.x);
      back.position.copy(this.low).addScaledVector(this.side, 0.5).setZ(head.origin[2]).addScaledVector(towards, isPins ? -0.011 * this.side.x : -0.15 * pitch);
      this.root.add(back, this.array);
    }
    const matrix = new Matrix4();
    const turn = new Quaternion().setFromUnitVectors(UP, towards);
    const colour = new Color();
    for (let i = 0; i < nx; i++)
      for (let j = 0; j < ny; j++) {
        const n = i * ny + j;
        const size = Math.hypot(forces[3 * n]!, forces[3 * n + 1]!, forces[3 * n + 2]!) / this.top;
        const raised = Math.min(size, 1.2);
        const height = (0.1 + (isPins ? 1.6 : 0.9) * raised) * pitch;
        const wide = (isPins ? 1 : 0.55 + 0.6 * raised) * pitch;
        const at = new Vector3(head.origin[0] + i * head.spacing[0], head.origin[1] + j * head.spacing[1], head.origin[2]);
        matrix.compose(at.addScaledVector(towards, height / 2), turn, new Vector3(wide, height, wide));
        this.array.setMatrixAt(n, matrix);
        const [r, g, b] = size > 0 ? TABLE.subarray(rowOf(size, this.limit)) : [148, 158, 174];
        this.array.setColorAt(n, colour.setRGB(r! / 255, g! / 255, b! / 255, SRGBColorSpace));
      }
    this.array.instanceMatrix.needsUpdate = true;
    if (this.array.instanceColor) this.array.instanceColor.needsUpdate = true;
    this.bodies = nx * ny;
  }

  /** The slice: |F| as colours, cones where the force points, and what is in front of it cut open. */
  cut(cut: Cut): void {
    this.cutAt = { axis: cut.axis, at: cut.at };
    const key = [cut.axis, cut.across, cut.up].join();
    if (this.slice.userData.key !== key) this.makeSlice(cut);
    this.slice.userData.key = key;
    const [sheet, , cones] = this.slice.children as [Mesh, LineSegments, InstancedMesh];
    this.slice.position.setComponent(cut.axis, cut.at);
    const colours = sheet.geometry.getAttribute("color") as BufferAttribute;
    this.paint(cut, colours.array as Float32Array);
    colours.needsUpdate = true;
    this.arrows(cut, cones);
    this.setClip();
    if (!this.labels.some((l) => l.element.classList.contains("handle")))
      this.label("↔ drag the slice", () => this.handle(), "handle");
    this.due();
  }

  /** The objects of a slice, which stay until its axis or its number of samples changes. */
  private makeSlice(cut: Cut): void {
    for (const child of [...this.slice.children]) dispose(child, false), this.slice.remove(child);
    const [a, b] = [(cut.axis + 1) % 3, (cut.axis + 2) % 3] as [number, number];
    const sheet = new Mesh(this.sheetOf(cut, a, b), this.sheet);
    const frame = new LineSegments(new EdgesGeometry(new PlaneGeometry(this.side.getComponent(a), this.side.getComponent(b))), this.rim);
    frame.applyMatrix4(new Matrix4().makeBasis(axisVector(a), axisVector(b), axisVector(cut.axis)));
    frame.position.copy(this.low).addScaledVector(this.side, 0.5).setComponent(cut.axis, 0);
    const cones = new InstancedMesh(new ConeGeometry(0.2, 1, 10).translate(0, 0.5, 0), this.white, (CONES + 1) ** 2);
    cones.frustumCulled = false;
    this.slice.position.set(0, 0, 0);
    this.slice.add(sheet, frame, cones);
  }

  /** A sheet with a vertex at each sample; those at its rim lie on the rim of the box. */
  private sheetOf(cut: Cut, a: number, b: number): BufferGeometry {
    const [m, n] = [Math.max(cut.across, 2), Math.max(cut.up, 2)];
    const along = (i: number, count: number, axis: number): number =>
      this.low.getComponent(axis) + this.side.getComponent(axis) * (i === 0 ? 0 : i === count - 1 ? 1 : (i + 0.5) / count);
    const positions = new Float32Array(3 * m * n);
    const index: number[] = [];
    for (let i = 0; i < m; i++)
      for (let j = 0; j < n; j++) {
        const at = i * n + j;
        positions[3 * at + a] = along(i, m, a);
        positions[3 * at + b] = along(j, n, b);
        if (i && j) index.push(at, at - 1, at - n, at - 1, at - n - 1, at - n);
      }
    const geometry = new BufferGeometry().setIndex(index);
    geometry.setAttribute("position", new BufferAttribute(positions, 3));
    return geometry.setAttribute("color", new BufferAttribute(new Float32Array(4 * m * n), 4));
  }

  /** The colours of the vertices of a sheet, as the light adds them up; where there is no force, it is nearly clear. */
  private paint(cut: Cut, colours: Float32Array): void {
    const [m, n] = [Math.max(cut.across, 2), Math.max(cut.up, 2)];
    for (let i = 0, to = 0; i < m; i++)
      for (let j = 0; j < n; j++, to += 4) {
        const size = sizeAt(cut.forces, Math.min(i, cut.across - 1) * cut.up + Math.min(j, cut.up - 1)) / this.top;
        const row = rowOf(size, this.limit);
        for (let k = 0; k < 3; k++) colours[to + k] = size > 1e-3 ? LINEAR[row + k]! : 1;
        colours[to + 3] = size > 1e-3 ? 1 : 0.07;
      }
  }

  /** Where the slice is dragged: the corner of it that lies highest, to the right, on the screen. */
  private handle(): Vector3 | null {
    if (!this.cutAt) return null;
    const { axis, at } = this.cutAt;
    const [a, b] = [(axis + 1) % 3, (axis + 2) % 3] as [number, number];
    let best: Vector3 | null = null;
    for (const i of [0.04, 0.96])
      for (const j of [0.04, 0.96]) {
        const p = this.low.clone().setComponent(axis, at);
        p.setComponent(a, p.getComponent(a) + i * this.side.getComponent(a));
        p.setComponent(b, p.getComponent(b) + j * this.side.getComponent(b));
        const [here, old] = [this.toScreen(p), best && this.toScreen(best)];
        if (!old || here.y + 0.3 * here.x > old.y + 0.3 * old.x) best = p;
      }
    return best;
  }

  /** Turn and place the cones of a slice: in each cell the largest force. */
  private arrows(cut: Cut, cones: InstancedMesh): void {
    const [a, b] = [(cut.axis + 1) % 3, (cut.axis + 2) % 3] as [number, number];
    const cell = Math.max(this.side.getComponent(a), this.side.getComponent(b)) / CONES;
    const step = [this.side.getComponent(a) / cut.across, this.side.getComponent(b) / cut.up];
    this.strongest.fill(-1);
    for (let n = 0; n < cut.across * cut.up; n++) {
      const at = (CONES + 1) * Math.floor((Math.floor(n / cut.up) * step[0]!) / cell) + Math.floor(((n % cut.up) * step[1]!) / cell);
      const old = this.strongest[at]!;
      if (sizeAt(cut.forces, n) > (old < 0 ? 0.01 * this.top : sizeAt(cut.forces, old))) this.strongest[at] = n;
    }
    const [matrix, force, position, turn, scale] = [new Matrix4(), new Vector3(), new Vector3(), new Quaternion(), new Vector3()];
    this.cones = 0;
    for (const n of this.strongest) {
      if (n < 0) continue;
      force.fromArray(cut.forces, 3 * n);
      const size = force.length();
      position.setComponent(cut.axis, 0);
      position.setComponent(a, this.low.getComponent(a) + (Math.floor(n / cut.up) + 0.5) * step[0]!);
      position.setComponent(b, this.low.getComponent(b) + ((n % cut.up) + 0.5) * step[1]!);
      const length = cell * (0.55 + 0.75 * Math.min(size / this.top, 1));
      cones.setMatrixAt(this.cones++, matrix.compose(position, turn.setFromUnitVectors(UP, force.divideScalar(size)), scale.setScalar(length)));
    }
    cones.count = this.cones;
    cones.instanceMatrix.needsUpdate = true;
  }

  setClip(): void {
    if (!this.cutAt || !this.directions) return;
    const normal = axisVector(this.cutAt.axis);
    const facing = this.camera.position.dot(normal) > 0 ? -1 : 1;
    const at = this.low.clone().setComponent(this.cutAt.axis, this.cutAt.at).applyMatrix4(this.root.matrixWorld);
    if (this.isOpen) this.clip.setFromNormalAndCoplanarPoint(normal.multiplyScalar(facing), at);
    else this.clip.set(normal, 1e6);
  }

  // -- probe --------------------------------------------------------------------------------------------------------

  private probeRadius(): number {
    return 0.009 * this.side.length();
  }

  private makeProbe(): void {
    const radius = this.probeRadius();
    const [sphere, rod] = [new SphereGeometry(1, 24, 16), new CylinderGeometry(1, 1, 1, 12).translate(0, 0.5, 0)];
    const cone = new ConeGeometry(1.1 * radius, 2.6 * radius, 16).translate(0, 1.3 * radius, 0);
    const over = { depthTest: false, transparent: true };
    const [orange, white] = [ACCENT, 0xffffff].map((color) => new MeshBasicMaterial({ ...over, color })) as [MeshBasicMaterial, MeshBasicMaterial];
    const [ball, rim, edge, proxy] = [new Mesh(sphere, orange), new Mesh(sphere, white), new Mesh(sphere, this.ink), new Mesh(sphere, white)];
    const [shaft, tip, string] = [new Mesh(rod, orange), new Mesh(cone, orange), new Mesh(rod, this.ink)];
    for (const [mesh, size] of [[ball, 1], [rim, 1.35], [edge, 0.9], [proxy, 0.7]] as const) mesh.scale.setScalar(size * radius);
    string.renderOrder = 10;
    edge.renderOrder = 11;
    proxy.renderOrder = 12;
    rim.renderOrder = 8;
    ball.renderOrder = shaft.renderOrder = tip.renderOrder = 9;
    this.probe.add(rim, ball, shaft, tip, string, edge, proxy);
    this.probe.visible = false;
    this.label("", () => (this.probe.visible ? this.probe.position.clone() : null), "probe");
  }

  /**
   * The probe at a point with the force that it feels, and the proxy on the surface, with a line to the probe; the
   * force's arrow is as long as a fifth of the box at the peak.
   */
  setProbe(point: Triple, force: ArrayLike<number>, text: string, proxy: Triple | null): void {
    const [, , shaft, tip, string, edge, ball] = this.probe.children as Object3D[] as [Object3D, Object3D, Object3D, Object3D, Object3D, Object3D, Object3D];
    const vector = new Vector3(force[0], force[1], force[2]);
    const size = vector.length();
    this.probe.visible = true;
    this.probe.position.set(...point);
    shaft.visible = tip.visible = size > 1e-4 * this.top;
    if (shaft.visible) {
      const length = (0.04 + 0.16 * Math.min(size / this.top, 1)) * this.side.length();
      vector.divideScalar(size);
      shaft.quaternion.setFromUnitVectors(UP, vector);
      tip.quaternion.copy(shaft.quaternion);
      shaft.scale.set(0.4 * this.probeRadius(), length, 0.4 * this.probeRadius());
      tip.position.copy(vector).multiplyScalar(length);
    }
    string.visible = edge.visible = ball.visible = proxy !== null;
    if (proxy) {
      const way = new Vector3(...proxy).sub(this.probe.position);
      edge.position.copy(way);
      ball.position.copy(way);
      string.scale.set(0.2 * this.probeRadius(), Math.max(way.length(), 1e-9), 0.2 * this.probeRadius());
      string.quaternion.setFromUnitVectors(UP, way.lengthSq() > 0 ? way.normalize() : UP);
    }
    const label = this.labels.find((l) => l.element.classList.contains("probe"));
    if (label) label.element.textContent = size > 0 ? text : "";
    this.due();
  }

  // -- screen -------------------------------------------------------------------------------------------------------

  /** The view has no plane of its own: the page asks for the ray. */
  pointAt(_x: number, _y: number): Triple | null {
    return null;
  }

  /** The ray through a position on the screen, metres. */
  ray(x: number, y: number): Ray {
    this.placeCamera();
    const box = this.canvas.getBoundingClientRect();
    const far = new Vector3(((x - box.left) / box.width) * 2 - 1, 1 - ((y - box.top) / box.height) * 2, 0.5).unproject(this.camera);
    const from = this.root.worldToLocal(this.camera.position.clone());
    const direction = this.root.worldToLocal(far).sub(from).normalize();
    return { from: from.toArray(), direction: direction.toArray() };
  }

  /** Rays from the middle of the screen outwards, for a first contact. */
  raysFromMiddle(): Ray[] {
    const box = this.canvas.getBoundingClientRect();
    const reach = 0.4 * Math.min(box.width, box.height);
    return Array.from({ length: 90 }, (_, n) => {
      const [turn, far] = [2.4 * n, reach * Math.sqrt(n / 90)];
      return this.ray(box.left + box.width / 2 + far * Math.cos(turn), box.top + box.height / 2 + far * Math.sin(turn));
    });
  }

  /** What the cut takes away. */
  away(): Away | null {
    if (!this.cutAt || !this.isOpen) return null;
    return { ...this.cutAt, side: this.camera.position.getComponent(this.cutAt.axis) > 0 ? 1 : -1 };
  }

  /** The point of a ray in the plane through another point that faces the camera. */
  facing(ray: Ray, through: Triple): Triple {
    const normal = this.root.worldToLocal(this.camera.position.clone()).sub(this.low.clone().addScaledVector(this.side, 0.5)).normalize();
    const direction = new Vector3(...ray.direction);
    const from = new Vector3(...ray.from);
    const t = new Vector3(...through).sub(from).dot(normal) / direction.dot(normal);
    return from.addScaledVector(direction, t).toArray();
  }

  /** Metres along the slice's axis for a movement on the screen, pixels. */
  dragged(dx: number, dy: number): number {
    const { axis, at } = this.cutAt!;
    const here = this.low.clone().addScaledVector(this.side, 0.5).setComponent(axis, at);
    const there = here.clone().setComponent(axis, at + 0.1 * this.side.getComponent(axis));
    const [p, q] = [this.toScreen(here), this.toScreen(there)];
    const { clientWidth: width, clientHeight: height } = this.canvas;
    const direction = [((q.x - p.x) * width) / 2, ((p.y - q.y) * height) / 2] as const;
    const square = direction[0] ** 2 + direction[1] ** 2;
    return square < 1 ? 0 : (0.1 * this.side.getComponent(axis) * (dx * direction[0] + dy * direction[1])) / square;
  }

  private toScreen(position: Vector3): Vector3 {
    return position.clone().applyMatrix4(this.root.matrixWorld).project(this.camera);
  }

  /** The middle of the lowest edge of the box along an axis, or, of the axis that is up, of the leftmost. */
  private edge(axis: number): Vector3 {
    const [a, b] = [(axis + 1) % 3, (axis + 2) % 3];
    const isUp = this.directions!.up[axis] !== 0;
    let best = new Vector3();
    let lowest = Infinity;
    for (const i of [-0.04, 1.04])
      for (const j of [-0.04, 1.04]) {
        const p = this.low.clone();
        p.setComponent(axis, p.getComponent(axis) + 0.5 * this.side.getComponent(axis));
        p.setComponent(a!, p.getComponent(a!) + i * this.side.getComponent(a!));
        p.setComponent(b!, p.getComponent(b!) + j * this.side.getComponent(b!));
        const at = this.toScreen(p);
        const score = isUp ? -at.x : at.y;
        if (score < lowest) (lowest = score), (best = p);
      }
    return best;
  }

  private corner(): Vector3 {
    let best = new Vector3();
    let highest = -Infinity;
    for (let n = 0; n < 8; n++) {
      const p = this.low.clone().add(new Vector3(n & 4 ? this.side.x : 0, n & 2 ? this.side.y : 0, n & 1 ? this.side.z : 0));
      const at = this.toScreen(p);
      if (at.y > highest) (highest = at.y), (best = p);
    }
    return best;
  }

  private label(text: string, position: () => Vector3 | null, name = ""): void {
    const element = document.createElement("span");
    element.textContent = text;
    if (name) element.className = name;
    this.overlay.append(element);
    this.labels.push({ element, position });
  }

  private draw(): void {
    this.placeCamera();
    this.setClip();
    this.renderer.render(this.scene, this.camera);
    const { clientWidth: width, clientHeight: height } = this.canvas;
    const halves = this.labels.map(({ element }) => element.offsetWidth / 2); // read before anything is written
    this.labels.forEach(({ element, position }, n) => {
      const at = position();
      element.hidden = !at || !element.textContent;
      if (!at) return;
      const p = this.toScreen(at);
      const lift = element.classList.contains("probe") ? 26 : 0;
      const half = halves[n]! + 4;
      element.style.left = `${Math.min(Math.max((width * (p.x + 1)) / 2 + lift, half), Math.max(width - half, half))}px`;
      element.style.top = `${Math.min(Math.max((height * (1 - p.y)) / 2 + lift, 14), height - 14)}px`;
    });
    if (this.head) this.onDrawn?.();
  }
}

/** A shirt about a panel of side 1, from the front. */
function garment(): Mesh {
  const half = [[0.13, 0.66], [0.3, 0.62], [0.62, 0.5], [0.92, 0.02], [0.72, -0.1], [0.58, 0.12], [0.58, -0.72]] as const;
  const positions = [0, -0.72, 0, 0, 0.55, 0, ...half.flatMap(([x, y]) => [x, y, 0, -x, y, 0])];
  const index: number[] = [];
  for (const side of [0, 1]) {
    const at = (n: number): number => 2 + 2 * n + side;
    for (const [a, b, c] of [[1, at(0), at(1)], [1, at(1), at(2)], [1, at(2), at(5)], [at(2), at(3), at(4)], [at(2), at(4), at(5)], [1, at(5), at(6)], [1, at(6), 0]] as const)
      index.push(a, b, c);
  }
  const geometry = new BufferGeometry().setAttribute("position", new BufferAttribute(new Float32Array(positions), 3)).setIndex(index);
  return new Mesh(geometry, new MeshBasicMaterial({ color: 0x334155, side: DoubleSide }));
}

const axisVector = (n: number): Vector3 => new Vector3().setComponent(n, 1);
const line = (color: number): LineBasicMaterial => new LineBasicMaterial({ color });
const sizeAt = (forces: Float32Array, n: number): number => Math.hypot(forces[3 * n]!, forces[3 * n + 1]!, forces[3 * n + 2]!);

function triangles(child: Object3D): number {
  return ((child as Mesh).geometry?.index?.count ?? 0) / 3;
}

/** The colours of TABLE as the light adds them up. */
const LINEAR = Float32Array.from(TABLE, (n) => new Color().setRGB(n / 255, 0, 0, SRGBColorSpace).r);

/** Give back what the graphics card stores of a thing; materials that others share are left. */
function dispose(child: Object3D, withMaterials = true): void {
  child.traverse((object) => {
    const mesh = object as Mesh;
    mesh.geometry?.dispose();
    if (object instanceof InstancedMesh) object.dispose();
    for (const material of withMaterials ? [mesh.material].flat() : []) material?.dispose();
  });
}
