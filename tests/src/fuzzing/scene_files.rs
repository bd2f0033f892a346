//! Fuzzes the readers of robots, scenes and meshes.
//!
//! Promises: an error is in words and names the file; a file that is read gives commands that a scene accepts, within the
//! limits of one; what is written as JSON reads back as the same commands.

use rhumb_protocol::limits::{BODIES_MAX, JOINTS_MAX};
use rhumb_scene_files::{
    FreeIds, LoadError, LoadOptions, LoadedScene, MemoryFiles, OwnContacts, SceneFile, load,
    load_text,
};

/// A file that its content names: URDF, MJCF, glTF or JSON. It may include itself and a part.
pub fn scene_files(data: &[u8]) {
    let mut files = MemoryFiles::default();
    files.insert("scene", data);
    files.insert(
        "part.xml",
        "<mujocoinclude><body name='part'><joint/><geom size='1'/></body></mujocoinclude>",
    );
    for own_contacts in [OwnContacts::AsFile, OwnContacts::All] {
        let options = LoadOptions {
            own_contacts,
            ..LoadOptions::default()
        };
        judge(load(&files, "scene", &options), "scene");
    }
}

/// A mesh: the first byte chooses STL, OBJ or MSH, and whether a body that moves has it or the ground.
pub fn mesh_files(data: &[u8]) {
    let Some((form, bytes)) = data.split_first() else {
        return;
    };
    let mesh = match (form & 4, form & 1) {
        (0, 0) => "m.stl",
        (0, _) => "m.obj",
        _ => "m.msh",
    };
    let mut files = MemoryFiles::default();
    files.insert(mesh, bytes);
    let link = if form & 2 == 0 { "a" } else { "world" };
    let robot = format!(
        "<robot name='r'><link name='{link}'><collision><geometry><mesh filename='{mesh}'/></geometry></collision></link></robot>"
    );
    files.insert("r.urdf", robot);
    judge(load(&files, "r.urdf", &LoadOptions::default()), "");
}

fn judge(read: Result<LoadedScene, LoadError>, file: &str) {
    let scene = match read {
        Ok(scene) => scene,
        Err(error) => {
            let sentence = error.to_string();
            assert!(!error.place.file.is_empty() && sentence.contains(&error.place.file));
            assert!(sentence.len() > error.place.file.len() + 4 && sentence.contains(file));
            return;
        }
    };
    assert!(scene.bodies.len() <= BODIES_MAX as usize && scene.joints.len() <= JOINTS_MAX as usize);
    for note in scene.report.notes() {
        assert!(!note.to_string().is_empty());
    }
    let Ok(commands) = scene.commands(FreeIds::default()) else {
        return;
    };
    for command in &commands {
        assert_eq!(command.check(), Ok(()), "{command:?}");
    }
    let text = serde_json::to_string(&SceneFile::of(&scene)).expect("finite numbers");
    let options = LoadOptions::default();
    let again = load_text(&MemoryFiles::default(), "written", &text, &options);
    let again = again.expect("what is written is read");
    assert!(again.report.is_empty(), "{:?}", again.report);
    assert_eq!(again.commands(FreeIds::default()), Ok(commands));
}
