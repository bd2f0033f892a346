extends Node3D
## Obeys a test: in each frame it prints what the nodes show, and evaluates the lines that it reads until `go`.
##
## Its arguments are the server's address, its fingerprint, the scene's name, its stepping and the depth. A scene whose name
## begins with `scripted` has a node with a script.

var scene: RhumbScene
var is_lockstep := false
## Number of events, by kind.
var counted := {}
var last_event := {}
## Names of nodes that appeared and that were removed.
var appeared := []
var removed := []
var answers := {}
## Actions of the handlers of signals.
var leaves_when_appeared := false
var frees_when_removed := false


func _ready() -> void:
	var arguments := OS.get_cmdline_user_args()
	if arguments[2].begins_with("scripted"):
		scene = (load("res://scripted_scene.gd") as GDScript).new()
	else:
		scene = RhumbScene.new()
	scene.address = arguments[0]
	scene.fingerprint = arguments[1]
	scene.scene_name = arguments[2]
	is_lockstep = arguments[3] == "lockstep"
	scene.stepping = 1 if is_lockstep else 0
	scene.depth = int(arguments[4])
	scene.smooth = false
	scene.join_at_start = false
	scene.joined.connect(func() -> void: say("joined"))
	scene.join_failed.connect(func(reason: String) -> void: say("join failed: " + reason))
	scene.ended.connect(func(reason: String) -> void: say("ended: " + reason))
	scene.body_appeared.connect(appear)
	scene.body_removed.connect(lose)
	scene.ray_answered.connect(func(number: int, hit: Dictionary) -> void: answers[number] = hit)
	scene.event.connect(count)
	add_child(scene)


func appear(body: RhumbBody) -> void:
	appeared.append(body.get_id())
	if leaves_when_appeared:
		scene.leave()


func lose(body: RhumbBody) -> void:
	removed.append(body.get_id())
	if frees_when_removed:
		body.free()


func count(kind: String, details: Dictionary) -> void:
	counted[kind] = counted.get(kind, 0) + 1
	last_event[kind] = details


func say(sentence: String) -> void:
	print("> ", sentence)


func _process(_delta: float) -> void:
	if not is_lockstep or not scene.is_joined():
		obey()


func _physics_process(_delta: float) -> void:
	if is_lockstep and scene.is_joined():
		obey()


func obey() -> void:
	for body in scene.get_bodies():
		var at := body.position
		var turn := body.quaternion
		print("body %d %.9f %.9f %.9f %.9f %.9f %.9f %.9f %.9f %.9f" % [
			body.get_id(), at.x, at.y, at.z, turn.x, turn.y, turn.z, turn.w, body.error_bound(),
			body.linear_velocity.y])
	print("frame %.9f" % scene.get_tick())
	while true:
		var line := OS.read_string_from_stdin(65536).strip_edges()
		if line == "go":
			return
		if line == "":
			# The test has ended.
			get_tree().quit(1)
			return
		var expression := Expression.new()
		if expression.parse(line, ["scene", "agent"]) != OK:
			print("= error: ", expression.get_error_text())
			continue
		var result: Variant = expression.execute([scene, self])
		print("= ", result)


## Lets real time pass, of which a frame takes almost none.
func rest() -> void:
	OS.delay_msec(5)


func body(id: int) -> RhumbBody:
	return scene.get_body(id)


func add(shape: Shape3D, kind: int, at: Vector3) -> int:
	var node := RhumbBody.new()
	node.shape = shape
	node.kind = kind
	node.position = at
	scene.add_child(node)
	return node.get_id()


func add_ball(x: float, y: float, z: float) -> int:
	var ball := SphereShape3D.new()
	ball.radius = 0.5
	return add(ball, 1, Vector3(x, y, z))


func add_scripted() -> int:
	var node: RhumbBody = (load("res://scripted_body.gd") as GDScript).new()
	scene.add_child(node)
	return node.get_id()


func add_scaled(scale: Vector3) -> int:
	var node := RhumbBody.new()
	node.shape = SphereShape3D.new()
	node.scale = scale
	scene.add_child(node)
	return node.get_id()


## Takes the scene out of the tree, and puts it back.
func move_scene() -> void:
	remove_child(scene)
	add_child(scene)


func set_option(option: String, value: bool) -> void:
	set(option, value)


func add_box(kind: int, size: Vector3, at: Vector3) -> int:
	var box := BoxShape3D.new()
	box.size = size
	return add(box, kind, at)


func add_heights(at: Vector3) -> int:
	var field := HeightMapShape3D.new()
	field.map_width = 3
	field.map_depth = 2
	# First along x, then along z.
	field.map_data = PackedFloat32Array([0.0, 1.0, 2.0, 10.0, 11.0, 12.0])
	return add(field, 0, at)


func add_boundary(plane: Plane) -> int:
	var boundary := WorldBoundaryShape3D.new()
	boundary.plane = plane
	return add(boundary, 0, Vector3.ZERO)


## The corners of a cube, in the middle of its edges' lengths.
func add_cube_of_points(at: Vector3) -> int:
	var hull := ConvexPolygonShape3D.new()
	var points := PackedVector3Array()
	for i in 8:
		points.append(Vector3(i & 1, (i >> 1) & 1, (i >> 2) & 1) - Vector3(0.5, 0.5, 0.5))
	hull.points = points
	return add(hull, 1, at)


func add_triangles(at: Vector3) -> int:
	var mesh := ConcavePolygonShape3D.new()
	mesh.set_faces(PackedVector3Array([
		Vector3(-1, 0, -1), Vector3(-1, 0, 1), Vector3(1, 0, 1),
		Vector3(-1, 0, -1), Vector3(1, 0, 1), Vector3(1, 0, -1)]))
	return add(mesh, 0, at)


## A flat sheet or a ball with settings of its own, by name.
func add_set(settings: Dictionary) -> int:
	var node := RhumbBody.new()
	if settings.has("edges"):
		var mesh := ConcavePolygonShape3D.new()
		mesh.set_faces(PackedVector3Array([Vector3(0, 0, 0), Vector3(0, 0, 1), Vector3(1, 0, 0)]))
		node.shape = mesh
		node.kind = 0
	else:
		node.shape = SphereShape3D.new()
	for setting: String in settings:
		node.set(setting, settings[setting])
	scene.add_child(node)
	return node.get_id()


func add_capsule(at: Vector3) -> int:
	var capsule := CapsuleShape3D.new()
	capsule.radius = 0.25
	capsule.height = 2.0
	return add(capsule, 1, at)


## A capsule without a straight part.
func add_round_capsule(at: Vector3) -> int:
	var capsule := CapsuleShape3D.new()
	capsule.radius = 0.25
	capsule.height = 0.5
	return add(capsule, 1, at)


func add_cylinder(at: Vector3) -> int:
	var cylinder := CylinderShape3D.new()
	cylinder.radius = 0.5
	cylinder.height = 3.0
	return add(cylinder, 1, at)


## A node whose properties describe no body, below the scene or elsewhere.
func add_wrong(parent: Node) -> int:
	var node := RhumbBody.new()
	parent.add_child(node)
	return node.get_id()


## Frees a child that may not be shown yet.
func free_late(id: int) -> void:
	for child in scene.get_children():
		if child.get_id() == id:
			child.free()


func free_node(id: int) -> void:
	body(id).queue_free()


func shape_class(id: int) -> String:
	var shape := body(id).shape
	return shape.get_class() if shape != null else "null"


func add_walker(at: Vector3) -> int:
	var capsule := CapsuleShape3D.new()
	capsule.radius = 0.25
	capsule.height = 1.5
	return add(capsule, 2, at)


## Makes a body a character that climbs steps.
func make_character(id: int) -> Error:
	var character := RhumbCharacter.new()
	character.step_height = 0.5
	character.step_width = 0.125
	return body(id).set_character(character)


## Makes a box a vehicle on four wheels.
func make_vehicle(id: int) -> Error:
	var wheels: Array[RhumbWheel] = []
	for z: float in [-1.25, 1.25]:
		for x: float in [-0.75, 0.75]:
			var wheel := RhumbWheel.new()
			wheel.position = Vector3(x, -0.125, z)
			wheel.radius = 0.25
			wheels.append(wheel)
	return body(id).set_vehicle(wheels)


## Rolls by the rear wheels.
func drive(id: int, force: float) -> Error:
	var inputs: Array[RhumbWheelInput] = []
	for wheel in 4:
		var input := RhumbWheelInput.new()
		input.force = force if wheel >= 2 else 0.0
		inputs.append(input)
	return body(id).set_wheels(inputs)


func plain_wheel() -> RhumbWheel:
	return RhumbWheel.new()


func plain_character() -> RhumbCharacter:
	return RhumbCharacter.new()


## Hangs a body on another one by a hinge about z, which a motor turns.
func add_hinge(number: int, first: int, second: int, velocity: float) -> Error:
	var joint := RhumbJoint.new()
	joint.kind = 2
	joint.first_anchor = Vector3(0, -0.5, 0)
	joint.second_anchor = Vector3(0, 1, 0)
	# The hinge turns about x of its frames.
	joint.first_rotation = Quaternion(Vector3(0, 1, 0), -PI / 2)
	joint.second_rotation = joint.first_rotation
	joint.limit(3, -0.5, 1.0)
	joint.motor(3, 0.0, velocity, 0.0, 10.0)
	return scene.add_joint(number, body(first), body(second), joint)


func add_wrong_hinge(first: int, second: int) -> Error:
	var joint := RhumbJoint.new()
	joint.kind = 2
	joint.limit(0, -1.0, 1.0)
	return scene.add_joint(8, body(first), body(second), joint)
