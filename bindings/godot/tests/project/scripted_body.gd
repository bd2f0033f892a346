extends RhumbBody
## A body whose script describes it when it is ready.


func _ready() -> void:
	shape = SphereShape3D.new()
	position = Vector3(0, 50, 0)
