/** Words of the viewer in other languages; errors are told in English. */

const LANGUAGES = ["de", "fr", "es", "zh", "ja"] as const;

/** English, and the same in `LANGUAGES`. */
const TABLE: Readonly<Partial<Record<string, readonly [string, string, string, string, string]>>> = {
  "View before": ["Ansicht davor", "Vue précédente", "Vista anterior", "上一视角", "前の視点"],
  "Next view": ["Nächste Ansicht", "Vue suivante", "Vista siguiente", "下一视角", "次の視点"],
  "First view": ["Erste Ansicht", "Première vue", "Primera vista", "初始视角", "最初の視点"],
  "See all of it": ["Alles sehen", "Tout voir", "Ver todo", "查看全部", "全体を見る"],
  "Tour of the notes": ["Rundgang", "Visite guidée", "Recorrido", "导览", "ツアー"],
  "Walk": ["Gehen", "Marcher", "Caminar", "步行", "歩く"],
  "Compare two levels": ["Zwei Stufen vergleichen", "Comparer deux niveaux", "Comparar dos niveles", "比较两级", "2段階を比較"],
  "Figures": ["Zahlen", "Chiffres", "Cifras", "数据", "数値"],
  "Save a picture": ["Bild speichern", "Enregistrer l'image", "Guardar imagen", "保存图片", "画像を保存"],
  "Light or dark": ["Hell oder dunkel", "Clair ou sombre", "Claro u oscuro", "浅色或深色", "明暗切替"],
  "Full screen": ["Vollbild", "Plein écran", "Pantalla completa", "全屏", "全画面"],
  "Headset": ["VR-Brille", "Casque VR", "Visor VR", "VR 头显", "VRゴーグル"],
  "Keys and gestures": ["Tasten und Gesten", "Touches et gestes", "Teclas y gestos", "按键与手势", "操作方法"],
  "More": ["Mehr", "Plus", "Más", "更多", "その他"],
  "Close": ["Schließen", "Fermer", "Cerrar", "关闭", "閉じる"],
  "Level": ["Stufe", "Niveau", "Nivel", "级别", "レベル"],
  "Left level": ["Linke Stufe", "Niveau à gauche", "Nivel izquierdo", "左侧级别", "左のレベル"],
  "Mouse": ["Maus", "Souris", "Ratón", "鼠标", "マウス"],
  "Touch": ["Finger", "Doigts", "Dedos", "触摸", "タッチ"],
  "Keys": ["Tasten", "Touches", "Teclas", "按键", "キー"],
  "drag": ["ziehen", "glisser", "arrastrar", "拖动", "ドラッグ"],
  "right drag": ["rechts ziehen", "glisser à droite", "arrastrar con derecho", "右键拖动", "右ドラッグ"],
  "middle drag": ["Mitte ziehen", "glisser au milieu", "arrastrar con central", "中键拖动", "中ドラッグ"],
  "wheel": ["Rad", "molette", "rueda", "滚轮", "ホイール"],
  "double click": ["Doppelklick", "double-clic", "doble clic", "双击", "ダブルクリック"],
  "double tap": ["zweimal tippen", "toucher deux fois", "tocar dos veces", "双击", "ダブルタップ"],
  "one finger": ["ein Finger", "un doigt", "un dedo", "单指", "1本指"],
  "two fingers": ["zwei Finger", "deux doigts", "dos dedos", "双指", "2本指"],
  "pinch": ["auf und zu", "pincer", "pellizcar", "捏合", "ピンチ"],
  "turn around the scene": ["um die Szene drehen", "tourner autour", "girar", "环绕", "回転"],
  "shift it": ["verschieben", "déplacer", "desplazar", "平移", "移動"],
  "look around": ["umsehen", "regarder autour", "mirar alrededor", "环顾", "見回す"],
  "nearer, farther": ["näher, weiter", "zoomer", "acercar, alejar", "缩放", "拡大・縮小"],
  "look there": ["dorthin sehen", "regarder là", "mirar ahí", "看向此处", "そこを見る"],
  "fly, faster with Shift": ["fliegen, schneller mit Shift", "voler, vite avec Shift", "volar, rápido con Shift", "飞行,Shift 加速", "飛ぶ、Shiftで加速"],
  "fly down, up": ["hinab, hinauf", "descendre, monter", "bajar, subir", "下降,上升", "下降、上昇"],
  "make a note": ["Notiz schreiben", "écrire une note", "escribir una nota", "添加注释", "メモを書く"],
  "Note before": ["Notiz davor", "Note précédente", "Nota anterior", "上一条", "前のメモ"],
  "Next note": ["Nächste Notiz", "Note suivante", "Nota siguiente", "下一条", "次のメモ"],
  "Title": ["Titel", "Titre", "Título", "标题", "題"],
  "Text": ["Text", "Texte", "Texto", "文字", "本文"],
  "Delete": ["Löschen", "Supprimer", "Borrar", "删除", "削除"],
  "Save all": ["Alle speichern", "Tout enregistrer", "Guardar todo", "全部保存", "すべて保存"],
  "Importing…": ["Wird importiert…", "Importation…", "Importando…", "正在导入…", "インポート中…"],
  "Drag to turn, wheel to zoom, double click to look there": [
    "Ziehen dreht, das Rad zoomt, Doppelklick sieht hin", "Glisser pour tourner, molette pour zoomer", "Arrastra para girar, rueda para acercar",
    "拖动旋转,滚轮缩放,双击注视", "ドラッグで回転、ホイールで拡大"],
  "One finger turns, two move and zoom": [
    "Ein Finger dreht, zwei schieben und zoomen", "Un doigt tourne, deux déplacent et zooment", "Un dedo gira, dos mueven y acercan",
    "单指旋转,双指平移缩放", "1本指で回転、2本指で移動と拡大"],
};

let column = -1;

/** Choose a language by the tags that somebody reads, in order of preference; English where none of them is there. */
export function speak(tags: readonly string[]): void {
  const known = tags.map((tag) => tag.slice(0, 2).toLowerCase()).find((tag) => tag === "en" || (LANGUAGES as readonly string[]).includes(tag));
  column = (LANGUAGES as readonly (string | undefined)[]).indexOf(known);
}

/** The words in the language that was chosen, the English ones where the table has none. */
export function translated(english: string): string {
  return (column >= 0 ? TABLE[english]?.[column] : undefined) ?? english;
}
