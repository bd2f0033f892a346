extends RhumbScene
## A script with every method that Godot calls, each of which replaces the extension's.

var calls := {}


func _enter_tree() -> void:
	calls["enter"] = true


func _ready() -> void:
	calls["ready"] = true


func _process(_delta: float) -> void:
	calls["process"] = true


func _physics_process(_delta: float) -> void:
	calls["physics"] = true


func _exit_tree() -> void:
	calls["exit"] = true
