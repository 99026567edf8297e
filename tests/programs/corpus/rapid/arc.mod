MODULE Arc
  PERS tooldata gun:=[TRUE,[[97.4,0,223.1],[0.924,0,0.383,0]],[5,[23,0,75],[1,0,0,0],0,0,0]];
  PERS wobjdata fixture:=[FALSE,TRUE,"",[[300,600,200],[1,0,0,0]],[[0,200,30],[0.7071068,0,0,0.7071068]]];
  PERS seamdata seam1:=[0.5,0.5,[5,0,24,120,0,0,0,0,0],0,0,0,0,0,[0,0,0,0,0,0,0,0,0],0,0,[0,0,0,0,0,0,0,0,0],0.5];
  CONST robtarget pStart:=<9|gun|fixture>;
  CONST robtarget pEnd:=<10|gun|fixture>;
  CONST robtarget pAbove:=RelTool(pStart,0,0,-50);
  PROC seam()
    MoveJ pAbove,v1000,z10,gun\WObj:=fixture;
    ArcLStart pStart,v100,seam1,weld1\Weave:=weave1,fine,gun\WObj:=fixture;
    ArcL pEnd,v100,seam1,weld1,z1,gun\WObj:=fixture;
    MoveL RelTool(pEnd,0,0,-50\Rx:=5\Ry:=-3),v1000,z10,gun\WObj:=fixture;
  ENDPROC
  FUNC bool ready(\switch Wait|switch Now,num limit)
    RETURN limit>3;
  ENDFUNC
  TRAP stopped
    StopMove;
  ENDTRAP
ENDMODULE
