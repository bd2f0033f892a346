extends Node3D
## Balls fall into a pit; the physics runs in a Rhumb server.
##
## Arguments after `--`: the server's address, its fingerprint, and a file for a picture after a second. The space
## bar kicks the balls upwards.

## Balls along each edge of the falling block, and layers of it.
const EDGE := 8
const LAYERS := 4
## Metres.
const RADIUS := 0.4
## Speed that the space bar gives to a ball, m/s.
const KICK := 8.0
## kg/m³.
const DENSITY := 1000.0
## Seconds from joining to the picture.
const PICTURE_AFTER := 1.0

@onready var scene: RhumbScene = $Scene


func _ready() -> void:
	var arguments := OS.get_cmdline_user_args()
	if arguments.size() < 2:
		fail("the arguments after -- are ADDRESS FINGERPRINT [PICTURE.png]")
		return
	scene.address = arguments[0]
	scene.fingerprint = arguments[1]
	scene.join_failed.connect(fail)
	scene.ended.connect(fail)
	scene.body_appeared.connect(dress)
	if arguments.size() > 2:
		scene.joined.connect(take_picture.bind(arguments[2]))
	add_balls()
	for body: RhumbBody in scene.get_children():
		dress(body)
	scene.join()


## Adds nodes for the balls. Their bodies are added when the scene is joined, if it is empty.
func add_balls() -> void:
	var ball := SphereShape3D.new()
	ball.radius = RADIUS
	var middle := 0.5 * (EDGE - 1)
	for layer in LAYERS:
		for row in EDGE:
			for column in EDGE:
				var body := RhumbBody.new()
				body.shape = ball
				body.density = DENSITY
				# Each layer is a little aside of the one below, so that balls roll off each other.
				var aside := 0.1 * (layer % 3)
				body.position = Vector3(
					2.2 * RADIUS * (row - middle) + aside,
					4.0 + 2.2 * RADIUS * layer,
					2.2 * RADIUS * (column - middle) - aside)
				scene.add_child(body)


## Gives the node of a body something to draw.
func dress(body: RhumbBody) -> void:
	var instance := MeshInstance3D.new()
	var material := StandardMaterial3D.new()
	if body.shape is SphereShape3D:
		var sphere := SphereMesh.new()
		sphere.radius = body.shape.radius
		sphere.height = 2.0 * body.shape.radius
		instance.mesh = sphere
		material.albedo_color = Color.from_hsv(randf_range(0.52, 0.6), 0.55, 0.85)
	elif body.shape is BoxShape3D:
		var box := BoxMesh.new()
		box.size = body.shape.size
		instance.mesh = box
		material.albedo_color = Color(0.55, 0.6, 0.65)
	elif body.shape != null:
		instance.mesh = body.shape.get_debug_mesh()
	instance.material_override = material
	body.add_child(instance)


func _unhandled_key_input(event: InputEvent) -> void:
	if not event.is_action_pressed("ui_select") or not scene.is_joined():
		return
	for body in scene.get_bodies():
		if body.shape is SphereShape3D:
			var mass: float = DENSITY * 4.0 / 3.0 * PI * pow(body.shape.radius, 3.0)
			body.apply_impulse(Vector3(0.0, KICK * mass, 0.0))


func take_picture(file: String) -> void:
	await get_tree().create_timer(PICTURE_AFTER).timeout
	await RenderingServer.frame_post_draw
	var error := get_viewport().get_texture().get_image().save_png(file)
	if error != OK:
		fail("the picture %s cannot be written: %s" % [file, error_string(error)])
		return
	get_tree().quit()


func fail(reason: String) -> void:
	printerr(reason)
	get_tree().quit(1)
